"""Adds nodes and references to a server's address space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer

Value = bool | int | float | str | Sequence[str]
_BUILDER = User(role=UserRole.Admin, name="beltscape")


class Builder:
    """Adds nodes under the identifiers that it is given, so that they are the same in every run."""

    def __init__(self, server: InternalServer) -> None:
        self._service = server.node_mgt_service

    def add_object(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        name: ua.QualifiedName,
        kind: ua.NodeId | int = ua.ObjectIds.BaseObjectType,
        reference: int = ua.ObjectIds.HasComponent,
    ) -> ua.NodeId:
        """Add an object of a type."""
        attributes = ua.ObjectAttributes()
        attributes.DisplayName = ua.LocalizedText(name.Name)
        return self._add(node, parent, name, reference, ua.NodeClass.Object, attributes, _identify(kind))

    def add_object_type(
        self, node: ua.NodeId, parent: ua.NodeId, name: ua.QualifiedName, *, abstract: bool
    ) -> ua.NodeId:
        """Add a subtype of an object type."""
        attributes = ua.ObjectTypeAttributes()
        attributes.DisplayName = ua.LocalizedText(name.Name)
        attributes.IsAbstract = abstract
        kind = ua.NodeClass.ObjectType
        return self._add(node, parent, name, ua.ObjectIds.HasSubtype, kind, attributes, ua.NodeId())

    def add_data_type(
        self, node: ua.NodeId, parent: ua.NodeId, name: ua.QualifiedName, *, abstract: bool
    ) -> ua.NodeId:
        """Add a subtype of a data type."""
        attributes = ua.DataTypeAttributes()
        attributes.DisplayName = ua.LocalizedText(name.Name)
        attributes.IsAbstract = abstract
        kind = ua.NodeClass.DataType
        return self._add(node, parent, name, ua.ObjectIds.HasSubtype, kind, attributes, ua.NodeId())

    def add_variable_type(self, node: ua.NodeId, parent: ua.NodeId, name: ua.QualifiedName) -> ua.NodeId:
        """Add a subtype of a variable type, of numbers."""
        attributes = ua.VariableTypeAttributes()
        attributes.DisplayName = ua.LocalizedText(name.Name)
        attributes.DataType = ua.NodeId(ua.ObjectIds.Number)
        attributes.ValueRank = ua.ValueRank.Scalar
        kind = ua.NodeClass.VariableType
        return self._add(node, parent, name, ua.ObjectIds.HasSubtype, kind, attributes, ua.NodeId())

    def add_variable(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        name: ua.QualifiedName,
        value: ua.Variant,
        kind: ua.NodeId | int = ua.ObjectIds.BaseDataVariableType,
        *,
        text: str = "",
        historic: bool = False,
    ) -> ua.NodeId:
        """Add a variable that clients read; ``text`` describes it, ``historic``: its history can be read."""
        attributes = ua.VariableAttributes()
        attributes.DisplayName = ua.LocalizedText(name.Name)
        attributes.Description = ua.LocalizedText(text)
        attributes.Value = value
        attributes.DataType = _find_data_type(value)
        attributes.ValueRank = ua.ValueRank.OneDimension if value.is_array else ua.ValueRank.Scalar
        attributes.ArrayDimensions = [0] if value.is_array else []
        level = ua.AccessLevel.CurrentRead.mask | (ua.AccessLevel.HistoryRead.mask if historic else 0)
        attributes.AccessLevel = attributes.UserAccessLevel = level
        attributes.Historizing = historic
        is_property = kind == ua.ObjectIds.PropertyType
        reference = ua.ObjectIds.HasProperty if is_property else ua.ObjectIds.HasComponent
        return self._add(node, parent, name, reference, ua.NodeClass.Variable, attributes, _identify(kind))

    def add_property(
        self, node: ua.NodeId, parent: ua.NodeId, name: ua.QualifiedName, value: ua.Variant
    ) -> ua.NodeId:
        """Add a property."""
        return self.add_variable(node, parent, name, value, ua.ObjectIds.PropertyType)

    def add_method(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        name: ua.QualifiedName,
        inputs: Sequence[ua.Argument],
        text: str,
    ) -> ua.NodeId:
        """Add a method with its arguments, which gives nothing back."""
        attributes = ua.MethodAttributes()
        attributes.DisplayName = ua.LocalizedText(name.Name)
        attributes.Description = ua.LocalizedText(text)
        attributes.Executable = attributes.UserExecutable = True
        kind = ua.NodeClass.Method
        self._add(node, parent, name, ua.ObjectIds.HasComponent, kind, attributes, ua.NodeId())
        if inputs:
            arguments = ua.Variant(list(inputs), ua.VariantType.ExtensionObject, is_array=True)
            identifier = ua.NodeId(f"{node.Identifier}.InputArguments", node.NamespaceIndex)
            self.add_property(identifier, node, ua.QualifiedName("InputArguments", 0), arguments)
        return node

    def refer(self, source: ua.NodeId, target: ua.NodeId, reference: int, kind: ua.NodeClass) -> None:
        """Add a reference in both directions."""
        for one, other, forward in ((source, target, True), (target, source, False)):
            item = ua.AddReferencesItem()
            item.SourceNodeId, item.TargetNodeId = one, other
            item.ReferenceTypeId, item.IsForward = ua.NodeId(reference), forward
            item.TargetNodeClass = kind
            self._service.add_references([item], _BUILDER)[0].check()

    def _add(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        name: ua.QualifiedName,
        reference: int,
        node_class: ua.NodeClass,
        attributes: object,
        kind: ua.NodeId,
    ) -> ua.NodeId:
        item = ua.AddNodesItem()
        item.RequestedNewNodeId, item.ParentNodeId, item.BrowseName = node, parent, name
        item.ReferenceTypeId, item.NodeClass = ua.NodeId(reference), node_class
        item.NodeAttributes, item.TypeDefinition = attributes, kind
        (result,) = self._service.add_nodes([item], _BUILDER)
        result.StatusCode.check()
        return node


def _identify(kind: ua.NodeId | int) -> ua.NodeId:
    return kind if isinstance(kind, ua.NodeId) else ua.NodeId(kind)


def _find_data_type(value: ua.Variant) -> ua.NodeId:
    if value.VariantType is not ua.VariantType.ExtensionObject:
        return ua.NodeId(value.VariantType.value)
    first: Any = value.Value[0] if value.is_array else value.Value
    data_type: ua.NodeId = first.data_type
    return data_type

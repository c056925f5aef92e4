"""The address space of a server: its namespaces, and how nodes and references are added to it.

The order of the namespaces never changes, so a client may keep node identifiers over restarts. The numbers of types
are those of the published nodesets: OPC 10000-100 (DI) 1.05, OPC 40001-1 (Machinery) 1.04.1, OPC 40200 (Scales) 2.00,
OPC 40560 (Mining, General) 1.0.0 and OPC 40563-4 (Conveying) 1.0.0.
"""

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


OWN, DI, MACHINERY, SCALES, MINING, CONVEYING = range(2, 8)
"""Indices of the namespaces; 0 is OPC UA's, 1 the application's."""
URIS: dict[int, str] = {
    OWN: "urn:beltscape:opcua",
    DI: "http://opcfoundation.org/UA/DI/",
    MACHINERY: "http://opcfoundation.org/UA/Machinery/",
    SCALES: "http://opcfoundation.org/UA/Scales/V2/",
    MINING: "http://opcfoundation.org/UA/Mining/General/",
    CONVEYING: "http://opcfoundation.org/UA/Mining/TransportDumping/Conveying/",
}
VERSIONS: dict[int, str] = {
    DI: "1.05.0",
    MACHINERY: "1.04.1",
    SCALES: "2.00",
    MINING: "1.0.0",
    CONVEYING: "1.0.0",
}
"""Version of each companion specification."""

DEVICE_SET = ua.NodeId(5001, DI)
MACHINES = ua.NodeId(1001, MACHINERY)
TOPOLOGY_ELEMENT_TYPE = ua.NodeId(1001, DI)
COMPONENT_TYPE = ua.NodeId(15063, DI)
FUNCTIONAL_GROUP_TYPE = ua.NodeId(1005, DI)
MACHINERY_ITEM_STATE_TYPE = ua.NodeId(1002, MACHINERY)
ITEM_IDENTIFICATION_TYPE = ua.NodeId(1004, MACHINERY)
MACHINE_COMPONENTS_TYPE = ua.NodeId(1006, MACHINERY)
MACHINE_IDENTIFICATION_TYPE = ua.NodeId(1012, MACHINERY)
MONITORING_TYPE = ua.NodeId(1014, MACHINERY)
MINING_EQUIPMENT_TYPE = ua.NodeId(1002, MINING)
MINING_IDENTIFICATION_TYPE = ua.NodeId(1003, MINING)
BELT_CONVEYOR_TYPE = ua.NodeId(1003, CONVEYING)
BELT_SCALE_TYPE = ua.NodeId(1011, CONVEYING)
CONVEYOR_STATE_TYPE = ua.NodeId(1021, CONVEYING)
SCALE_DEVICE_TYPE = ua.NodeId(2, SCALES)
CONTINUOUS_SCALE_TYPE = ua.NodeId(10, SCALES)
TOTALIZER_TYPE = ua.NodeId(27, SCALES)
MEASURED_ITEM_TYPE = ua.NodeId(52, SCALES)


def own_id(path: str) -> ua.NodeId:
    """Return the identifier of one of this program's nodes, the same in every run."""
    return ua.NodeId(path, OWN)

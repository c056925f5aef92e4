"""The types of companion specifications that the server's objects have, with the members that it serves.

They carry the names and numbers of the published nodesets, so a client that knows those recognises the objects. The
nodesets themselves are not shipped: they are large, and hold far more than one belt scale serves. Each namespace says
in its metadata that it is a subset. A weight is the structure of OPC 40200: gross, net and tare (10.3, WeightType).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from beltscape.protocols.opcua.address_space import (
    BELT_CONVEYOR_TYPE,
    BELT_SCALE_TYPE,
    COMPONENT_TYPE,
    CONTINUOUS_SCALE_TYPE,
    CONVEYOR_STATE_TYPE,
    DI,
    FUNCTIONAL_GROUP_TYPE,
    ITEM_IDENTIFICATION_TYPE,
    MACHINE_COMPONENTS_TYPE,
    MACHINE_IDENTIFICATION_TYPE,
    MACHINERY,
    MACHINERY_ITEM_STATE_TYPE,
    MEASURED_ITEM_TYPE,
    MINING,
    MINING_EQUIPMENT_TYPE,
    MINING_IDENTIFICATION_TYPE,
    MONITORING_TYPE,
    SCALE_DEVICE_TYPE,
    SCALES,
    TOPOLOGY_ELEMENT_TYPE,
    TOTALIZER_TYPE,
    URIS,
    VERSIONS,
    Builder,
    own_id,
)

_FOLDER = ua.NodeId(ua.ObjectIds.FolderType)
_ANALOGUE = ua.NodeId(ua.ObjectIds.AnalogUnitType)
_TEXT = ua.NodeId(ua.ObjectIds.PropertyType)


@dataclass(frozen=True, slots=True)
class TypeMember:
    """A component, add-in or property that a type declares."""

    name: str
    namespace: int
    kind: ua.NodeId
    is_mandatory: bool = True


@dataclass(frozen=True, slots=True)
class ObjectType:
    """An object type with the members that are served."""

    node: ua.NodeId
    name: str
    parent: ua.NodeId
    members: tuple[TypeMember, ...] = ()
    is_abstract: bool = False


_EQUIPMENT = (
    TypeMember("MiningEquipmentIdentification", MINING, MINING_IDENTIFICATION_TYPE),
    TypeMember("MachineryBuildingBlocks", MACHINERY, _FOLDER),
)
_TYPES: tuple[ObjectType, ...] = (
    ObjectType(
        TOPOLOGY_ELEMENT_TYPE, "TopologyElementType", ua.NodeId(ua.ObjectIds.BaseObjectType), is_abstract=True
    ),
    ObjectType(COMPONENT_TYPE, "ComponentType", TOPOLOGY_ELEMENT_TYPE, is_abstract=True),
    ObjectType(FUNCTIONAL_GROUP_TYPE, "FunctionalGroupType", _FOLDER),
    ObjectType(
        ITEM_IDENTIFICATION_TYPE,
        "MachineryItemIdentificationType",
        FUNCTIONAL_GROUP_TYPE,
        (TypeMember("Manufacturer", DI, _TEXT), TypeMember("SerialNumber", DI, _TEXT)),
        is_abstract=True,
    ),
    ObjectType(
        MACHINE_IDENTIFICATION_TYPE,
        "MachineIdentificationType",
        ITEM_IDENTIFICATION_TYPE,
        (
            TypeMember("ProductInstanceUri", DI, _TEXT),
            TypeMember("Location", MACHINERY, _TEXT, is_mandatory=False),
        ),
    ),
    ObjectType(MACHINE_COMPONENTS_TYPE, "MachineComponentsType", ua.NodeId(ua.ObjectIds.BaseObjectType)),
    ObjectType(
        MONITORING_TYPE,
        "MonitoringType",
        _FOLDER,
        tuple(
            TypeMember(name, MACHINERY, _FOLDER, is_mandatory=False)
            for name in ("Process", "Status", "Health")
        ),
    ),
    ObjectType(
        MACHINERY_ITEM_STATE_TYPE,
        "MachineryItemState_StateMachineType",
        ua.NodeId(ua.ObjectIds.FiniteStateMachineType),
    ),
    ObjectType(
        MINING_IDENTIFICATION_TYPE,
        "MiningEquipmentIdentificationType",
        MACHINE_IDENTIFICATION_TYPE,
        tuple(TypeMember(name, DI, _TEXT) for name in ("AssetId", "DeviceClass", "ManufacturerUri", "Model")),
    ),
    ObjectType(
        MINING_EQUIPMENT_TYPE, "MiningEquipmentType", ua.NodeId(ua.ObjectIds.BaseObjectType), _EQUIPMENT
    ),
    ObjectType(
        CONVEYOR_STATE_TYPE, "BeltConveyorMachineryItemState_StateMachineType", MACHINERY_ITEM_STATE_TYPE
    ),
    ObjectType(
        BELT_CONVEYOR_TYPE,
        "BeltConveyorType",
        MINING_EQUIPMENT_TYPE,
        (
            *_EQUIPMENT,
            TypeMember("Components", MACHINERY, MACHINE_COMPONENTS_TYPE, is_mandatory=False),
            TypeMember("Monitoring", MACHINERY, MONITORING_TYPE),
        ),
    ),
    ObjectType(
        BELT_SCALE_TYPE,
        "BeltScaleType",
        MINING_EQUIPMENT_TYPE,
        (*_EQUIPMENT, TypeMember("Monitoring", MACHINERY, MONITORING_TYPE, is_mandatory=False)),
    ),
    ObjectType(
        SCALE_DEVICE_TYPE,
        "ScaleDeviceType",
        COMPONENT_TYPE,
        (TypeMember("Identification", DI, ITEM_IDENTIFICATION_TYPE),),
        is_abstract=True,
    ),
    ObjectType(
        TOTALIZER_TYPE,
        "TotalizerType",
        ua.NodeId(ua.ObjectIds.BaseObjectType),
        (TypeMember("TotalizedValue", SCALES, MEASURED_ITEM_TYPE),),
    ),
    ObjectType(
        CONTINUOUS_SCALE_TYPE,
        "ContinuousScaleType",
        SCALE_DEVICE_TYPE,
        (
            TypeMember("FlowRate", SCALES, MEASURED_ITEM_TYPE),
            TypeMember("Speed", SCALES, _ANALOGUE, is_mandatory=False),
            TypeMember("Load", SCALES, _ANALOGUE, is_mandatory=False),
            TypeMember("MasterTotalizer", SCALES, TOTALIZER_TYPE, is_mandatory=False),
        ),
    ),
)
"""In the order of inheritance."""


def add_types(builder: Builder) -> None:
    """Add the types and the metadata of their namespaces."""
    measured = ua.QualifiedName("MeasuredItemType", SCALES)
    builder.add_variable_type(MEASURED_ITEM_TYPE, ua.NodeId(ua.ObjectIds.DataItemType), measured)
    for kind in _TYPES:
        name = ua.QualifiedName(kind.name, kind.node.NamespaceIndex)
        builder.add_object_type(kind.node, kind.parent, name, abstract=kind.is_abstract)
        for member in kind.members:
            _add_member(builder, kind, member)
    for namespace, version in VERSIONS.items():
        _add_metadata(builder, namespace, version)


def _add_member(builder: Builder, kind: ObjectType, member: TypeMember) -> None:
    node = own_id(f"{kind.name}.{member.name}")
    name = ua.QualifiedName(member.name, member.namespace)
    if member.kind == _TEXT:
        builder.add_property(node, kind.node, name, ua.Variant("", ua.VariantType.String))
    elif member.kind in (_ANALOGUE, MEASURED_ITEM_TYPE):
        builder.add_variable(node, kind.node, name, ua.Variant(0.0, ua.VariantType.Double), member.kind)
    else:
        builder.add_object(node, kind.node, name, member.kind)
    mandatory, optional = ua.ObjectIds.ModellingRule_Mandatory, ua.ObjectIds.ModellingRule_Optional
    rule = ua.NodeId(mandatory if member.is_mandatory else optional)
    builder.refer(node, rule, ua.ObjectIds.HasModellingRule, ua.NodeClass.Object)


def _add_metadata(builder: Builder, namespace: int, version: str) -> None:
    """State that a namespace is a subset of the published one, and its version (OPC 10000-5, 6.3.14)."""
    uri = URIS[namespace]
    node = own_id(f"Namespaces.{uri}")
    parent, kind = ua.NodeId(ua.ObjectIds.Server_Namespaces), ua.ObjectIds.NamespaceMetadataType
    builder.add_object(node, parent, ua.QualifiedName(uri, namespace), kind)
    values = {
        "NamespaceUri": ua.Variant(uri, ua.VariantType.String),
        "NamespaceVersion": ua.Variant(version, ua.VariantType.String),
        "IsNamespaceSubset": ua.Variant(True, ua.VariantType.Boolean),
    }
    for name, value in values.items():
        builder.add_property(own_id(f"Namespaces.{uri}.{name}"), node, ua.QualifiedName(name, 0), value)


_ABSTRACT = ua.NodeId(63, SCALES)
_WEIGHT_ENCODING = ua.NodeId(88, SCALES)
"""Numbers of AbstractWeightType, and of the binary encoding of WeightType."""
_WEIGHT_FIELDS = ("Gross", "Net", "Tare")


@dataclass
class WeightType:
    """A weight in the variable's unit; the structure is fixed by the specification."""

    data_type: ClassVar[ua.NodeId] = ua.NodeId(55, SCALES)
    Gross: ua.Double = 0.0
    Net: ua.Double = 0.0
    Tare: ua.Double = 0.0


def make_weight(net: float) -> ua.Variant:
    """Return a weight without a tare."""
    return ua.Variant(WeightType(net, net, 0.0), ua.VariantType.ExtensionObject)


async def add_weight_type(server: InternalServer, builder: Builder) -> None:
    """Add the structure, with the definition by which clients decode it."""
    structure, abstract = ua.NodeId(ua.ObjectIds.Structure), ua.QualifiedName("AbstractWeightType", SCALES)
    builder.add_data_type(_ABSTRACT, structure, abstract, abstract=True)
    kind = WeightType.data_type
    builder.add_data_type(kind, _ABSTRACT, ua.QualifiedName("WeightType", SCALES), abstract=False)
    name, encoding = ua.QualifiedName("Default Binary", 0), ua.ObjectIds.DataTypeEncodingType
    builder.add_object(_WEIGHT_ENCODING, kind, name, encoding, ua.ObjectIds.HasEncoding)
    definition = ua.StructureDefinition()
    definition.BaseDataType, definition.DefaultEncodingId = _ABSTRACT, _WEIGHT_ENCODING
    definition.StructureType = ua.StructureType.Structure
    definition.Fields = [_make_field(field) for field in _WEIGHT_FIELDS]
    value = ua.DataValue(ua.Variant(definition, ua.VariantType.ExtensionObject))
    await server.write_attribute_value(kind, value, ua.AttributeIds.DataTypeDefinition)
    ua.register_extension_object("WeightType", _WEIGHT_ENCODING, WeightType, kind)


def _make_field(name: str) -> ua.StructureField:
    field = ua.StructureField()
    field.Name, field.DataType = name, ua.NodeId(ua.ObjectIds.Double)
    field.ValueRank, field.IsOptional = ua.ValueRank.Scalar, False
    return field

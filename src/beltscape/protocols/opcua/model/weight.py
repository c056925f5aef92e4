"""The structure in which OPC 40200 states a weight: gross, net and tare (10.3, WeightType)."""

# The library reads the types of the fields when the class is made, so annotations stay as they are.
from dataclasses import dataclass
from typing import ClassVar

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from beltscape.protocols.opcua.model.builder import Builder
from beltscape.protocols.opcua.model.namespaces import SCALES

_ABSTRACT = ua.NodeId(63, SCALES)
_ENCODING = ua.NodeId(88, SCALES)
"""Numbers of AbstractWeightType, and of the binary encoding of WeightType."""
_FIELDS = ("Gross", "Net", "Tare")


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
    builder.add_object(_ENCODING, kind, name, encoding, ua.ObjectIds.HasEncoding)
    definition = ua.StructureDefinition()
    definition.BaseDataType, definition.DefaultEncodingId = _ABSTRACT, _ENCODING
    definition.StructureType = ua.StructureType.Structure
    definition.Fields = [_make_field(field) for field in _FIELDS]
    value = ua.DataValue(ua.Variant(definition, ua.VariantType.ExtensionObject))
    await server.write_attribute_value(kind, value, ua.AttributeIds.DataTypeDefinition)
    ua.register_extension_object("WeightType", _ENCODING, WeightType, kind)


def _make_field(name: str) -> ua.StructureField:
    field = ua.StructureField()
    field.Name, field.DataType = name, ua.NodeId(ua.ObjectIds.Double)
    field.ValueRank, field.IsOptional = ua.ValueRank.Scalar, False
    return field

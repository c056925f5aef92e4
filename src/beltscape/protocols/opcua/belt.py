"""The objects of one belt: a conveyor among the machines, its scale, and what this program adds to them.

Engineering units have the codes of UNECE Recommendation 20, as OPC UA states units (OPC 10000-8).
"""

from __future__ import annotations

from asyncua import ua

from beltscape.protocols.opcua.address_space import (
    BELT_CONVEYOR_TYPE,
    BELT_SCALE_TYPE,
    CONTINUOUS_SCALE_TYPE,
    CONVEYING,
    CONVEYOR_STATE_TYPE,
    DEVICE_SET,
    DI,
    ITEM_IDENTIFICATION_TYPE,
    MACHINE_COMPONENTS_TYPE,
    MACHINERY,
    MACHINES,
    MEASURED_ITEM_TYPE,
    MINING,
    MINING_IDENTIFICATION_TYPE,
    MONITORING_TYPE,
    OWN,
    SCALES,
    TOTALIZER_TYPE,
    Builder,
    own_id,
)
from beltscape.protocols.opcua.quantities import QUANTITIES, RECORD_QUANTITIES, OpcUaQuantity
from beltscape.protocols.opcua.types import make_weight
from beltscape.protocols.plant import Provenance
from beltscape.protocols.settings import OpcUaSettings

_UNITS_URI = "http://www.opcfoundation.org/UA/units/un/cefact"
_UNIT_CODES: dict[str, tuple[str, str]] = {
    "m³/h": ("MQH", "cubic metre per hour"),
    "t/h": ("E18", "tonne per hour"),
    "m/s": ("MTS", "metre per second"),
    "m²": ("MTK", "square metre"),
    "kg/m": ("KL", "kilogram per metre"),
    "m³": ("MTQ", "cubic metre"),
    "t": ("TNE", "tonne"),
    "m": ("MTR", "metre"),
    "mm": ("MMT", "millimetre"),
    "kg": ("KGM", "kilogram"),
    "l": ("LTR", "litre"),
    "%": ("P1", "percent"),
}
"""Unit → common code of UNECE Recommendation 20, and name."""


def make_unit(unit: str) -> ua.EUInformation:
    """Return a unit; the identifier is its code's characters as one number."""
    code, name = _UNIT_CODES[unit]
    identifier = int.from_bytes(code.encode("ascii"), "big")
    return ua.EUInformation(_UNITS_URI, identifier, ua.LocalizedText(unit), ua.LocalizedText(name))


_FOLDER = ua.NodeId(ua.ObjectIds.FolderType)
_COMPONENT, _ADD_IN = ua.ObjectIds.HasComponent, ua.ObjectIds.HasAddIn
_MANUFACTURER = "Beltscape"
_MOST_T_H = 100_000.0
"""End of the flow's range where the settings give none, t/h: the largest belts carry some 40,000."""
_MOST_T = 1e10
"""End of the total's range, t: ten years of the largest belt are a third of it."""
_GROUPS: tuple[tuple[str, int, ua.NodeId, int], ...] = (
    ("Belt.MachineryBuildingBlocks", MACHINERY, _FOLDER, _COMPONENT),
    ("Belt.Components", MACHINERY, MACHINE_COMPONENTS_TYPE, _ADD_IN),
    ("Belt.Components.BeltScale", CONVEYING, BELT_SCALE_TYPE, _COMPONENT),
    ("Belt.Components.BeltScale.MachineryBuildingBlocks", MACHINERY, _FOLDER, _COMPONENT),
    ("Belt.Components.BeltScale.Monitoring", MACHINERY, MONITORING_TYPE, _COMPONENT),
    ("Belt.Components.BeltScale.Monitoring.Process", MACHINERY, _FOLDER, _COMPONENT),
    ("Belt.Components.Scale", OWN, CONTINUOUS_SCALE_TYPE, _COMPONENT),
    ("Belt.Components.Scale.MasterTotalizer", SCALES, TOTALIZER_TYPE, _COMPONENT),
    ("Belt.Monitoring", MACHINERY, MONITORING_TYPE, _COMPONENT),
    ("Belt.Monitoring.Process", MACHINERY, _FOLDER, _COMPONENT),
    ("Belt.Monitoring.Status", MACHINERY, _FOLDER, _COMPONENT),
    ("Belt.Monitoring.Status.MachineryItemState", MACHINERY, CONVEYOR_STATE_TYPE, _COMPONENT),
    ("Belt.Monitoring.Health", MACHINERY, _FOLDER, _COMPONENT),
    ("Belt.Totals", OWN, _FOLDER, _COMPONENT),
    ("Belt.Records", OWN, _FOLDER, _COMPONENT),
    ("Belt.Alarms", OWN, _FOLDER, _COMPONENT),
    ("Belt.Commands", OWN, _FOLDER, _COMPONENT),
    ("Belt.Provenance", OWN, _FOLDER, _COMPONENT),
)
"""Path, namespace of the name, type, and reference from the parent; parents first."""
_STATE = "Belt.Monitoring.Status.MachineryItemState.CurrentState"
FACTS: tuple[tuple[str, int, ua.VariantType, str], ...] = (
    (
        "Belt.Monitoring.Status.Quality",
        OWN,
        ua.VariantType.String,
        "valid, degraded or missing: the present flow",
    ),
    (
        "Belt.Monitoring.Status.Maintenance",
        OWN,
        ua.VariantType.String,
        "reason of the maintenance; empty: none",
    ),
    ("Belt.Monitoring.Status.Product", OWN, ua.VariantType.String, "present product; empty: none"),
    ("Belt.Monitoring.Status.Batch", OWN, ua.VariantType.String, "present batch; empty: none"),
    ("Belt.Monitoring.Health.CamerasOk", OWN, ua.VariantType.UInt32, "cameras without a fault"),
    ("Belt.Monitoring.Health.Cameras", OWN, ua.VariantType.UInt32, "cameras"),
    ("Belt.Monitoring.Health.Faults", OWN, ua.VariantType.UInt32, "checks with a fault"),
    ("Belt.Totals.Records", OWN, ua.VariantType.UInt64, "number of records in the totals"),
    ("Belt.Alarms.Active", OWN, ua.VariantType.UInt32, "alarms that are on"),
    ("Belt.Alarms.Unacknowledged", OWN, ua.VariantType.UInt32, "alarms that wait to be acknowledged"),
    (
        "Belt.Commands.LastRefusal",
        OWN,
        ua.VariantType.String,
        "why the last command was refused; empty: none was",
    ),
)
"""Variables without a unit: path, namespace of the name, type, meaning."""
_EMPTY: dict[ua.VariantType, object] = {ua.VariantType.String: ""}


def add_belt(builder: Builder, settings: OpcUaSettings, application: str, provenance: Provenance) -> None:
    """Add the belt with all its nodes; ``application`` is the server's unique identifier."""
    base = ua.NodeId(ua.ObjectIds.ObjectsFolder)
    name = ua.QualifiedName("Machines", MACHINERY)
    builder.add_object(MACHINES, base, name, _FOLDER, ua.ObjectIds.Organizes)
    builder.add_object(DEVICE_SET, base, ua.QualifiedName("DeviceSet", DI), reference=ua.ObjectIds.Organizes)
    root = own_id("Belt")
    builder.add_object(root, MACHINES, ua.QualifiedName(settings.name, OWN), BELT_CONVEYOR_TYPE)
    for path, namespace, kind, reference in _GROUPS:
        builder.add_object(own_id(path), _find_parent(path), _name(path, namespace), kind, reference)
    builder.refer(DEVICE_SET, own_id("Belt.Components.Scale"), ua.ObjectIds.Organizes, ua.NodeClass.Object)
    builder.refer(
        own_id("Belt.MachineryBuildingBlocks"), own_id("Belt.Components"), _ADD_IN, ua.NodeClass.Object
    )
    for path in ("Belt", "Belt.Components.BeltScale"):
        _add_identification(builder, path, settings, f"{application}:{path}")
    _add_scale_identification(builder, settings, provenance)
    for quantity in QUANTITIES:
        _add_quantity(builder, quantity, settings)
    _add_records(builder)
    _add_state(builder)
    for path, namespace, kind, text in FACTS:
        value = ua.Variant(_EMPTY.get(kind, 0), kind)
        builder.add_variable(own_id(path), _find_parent(path), _name(path, namespace), value, text=text)
    for key, text in provenance.items():
        value = ua.Variant(text, ua.VariantType.String)
        node = own_id(f"Belt.Provenance.{key}")
        builder.add_property(node, own_id("Belt.Provenance"), ua.QualifiedName(key, OWN), value)


def _add_identification(builder: Builder, path: str, settings: OpcUaSettings, instance: str) -> None:
    node, parent = own_id(f"{path}.MiningEquipmentIdentification"), own_id(path)
    name = ua.QualifiedName("MiningEquipmentIdentification", MINING)
    builder.add_object(node, parent, name, MINING_IDENTIFICATION_TYPE, _ADD_IN)
    blocks = own_id(f"{path}.MachineryBuildingBlocks")
    builder.refer(blocks, node, _ADD_IN, ua.NodeClass.Object)
    texts = {
        "AssetId": settings.asset_id,
        "DeviceClass": "Belt conveyor" if path == "Belt" else "Belt scale, optical",
        "ManufacturerUri": "urn:beltscape",
        "ProductInstanceUri": instance,
        "SerialNumber": settings.serial_number,
    }
    _add_texts(builder, node, texts, ("Manufacturer", "Model"))
    if settings.location:
        location = ua.Variant(settings.location, ua.VariantType.String)
        builder.add_property(
            _below(node, "Location"), node, ua.QualifiedName("Location", MACHINERY), location
        )


def _add_scale_identification(builder: Builder, settings: OpcUaSettings, provenance: Provenance) -> None:
    parent = own_id("Belt.Components.Scale")
    node = _below(parent, "Identification")
    builder.add_object(
        node, parent, ua.QualifiedName("Identification", DI), ITEM_IDENTIFICATION_TYPE, _ADD_IN
    )
    texts = {"SerialNumber": settings.serial_number, "SoftwareRevision": provenance.get("Program", "")}
    _add_texts(builder, node, texts, ("Manufacturer", "Model"))


def _add_texts(builder: Builder, node: ua.NodeId, texts: dict[str, str], names: tuple[str, ...]) -> None:
    """Add plain properties, and localised ones that hold the manufacturer's name."""
    for key, text in texts.items():
        value = ua.Variant(text, ua.VariantType.String)
        builder.add_property(_below(node, key), node, ua.QualifiedName(key, DI), value)
    for key in names:
        value = ua.Variant(ua.LocalizedText(_MANUFACTURER), ua.VariantType.LocalizedText)
        builder.add_property(_below(node, key), node, ua.QualifiedName(key, DI), value)


def _add_quantity(builder: Builder, quantity: OpcUaQuantity, settings: OpcUaSettings) -> None:
    node, parent = own_id(quantity.path), _find_parent(quantity.path)
    value = make_weight(0.0) if quantity.is_weight else ua.Variant(0.0, ua.VariantType.Double)
    builder.add_variable(
        node,
        parent,
        quantity.name,
        value,
        quantity.kind,
        text=quantity.text,
        historic=quantity.record is not None,
    )
    _add_unit(builder, node, quantity.unit)
    if quantity.kind == MEASURED_ITEM_TYPE:
        most = _MOST_T if quantity.is_weight else settings.full_t_h or _MOST_T_H
        span = ua.Variant(ua.Range(0.0, most), ua.VariantType.ExtensionObject)
        builder.add_property(_below(node, "EURange"), node, ua.QualifiedName("EURange", 0), span)


def _add_records(builder: Builder) -> None:
    for quantity in RECORD_QUANTITIES:
        node, parent = own_id(quantity.path), own_id("Belt.Records")
        kind = ua.ObjectIds.AnalogUnitType if quantity.unit else ua.ObjectIds.BaseDataVariableType
        value = ua.Variant(0, ua.VariantType.UInt64) if quantity.is_count else ua.Variant(0.0)
        builder.add_variable(
            node, parent, _name(quantity.path, OWN), value, kind, text=quantity.text, historic=True
        )
        if quantity.unit:
            _add_unit(builder, node, quantity.unit)


def _add_state(builder: Builder) -> None:
    """Add the state of the conveyor's state machine."""
    node, parent = own_id(_STATE), own_id("Belt.Monitoring.Status.MachineryItemState")
    name = ua.QualifiedName("CurrentState", 0)
    text = ua.Variant(ua.LocalizedText("NotAvailable"), ua.VariantType.LocalizedText)
    builder.add_variable(node, parent, name, text, ua.ObjectIds.FiniteStateVariableType)
    value = ua.Variant(ua.NodeId(), ua.VariantType.NodeId)
    builder.add_property(_below(node, "Id"), node, ua.QualifiedName("Id", 0), value)


def _add_unit(builder: Builder, node: ua.NodeId, unit: str) -> None:
    value = ua.Variant(make_unit(unit), ua.VariantType.ExtensionObject)
    name = ua.QualifiedName("EngineeringUnits", 0)
    builder.add_property(_below(node, "EngineeringUnits"), node, name, value)


def _find_parent(path: str) -> ua.NodeId:
    return own_id(path.rpartition(".")[0])


def _name(path: str, namespace: int) -> ua.QualifiedName:
    return ua.QualifiedName(path.rpartition(".")[2], namespace)


def _below(node: ua.NodeId, name: str) -> ua.NodeId:
    return own_id(f"{node.Identifier}.{name}")

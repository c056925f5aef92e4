"""Namespaces of the server, their fixed order, and the numbers of the types that it uses in each.

The numbers are those of the published nodesets: OPC 10000-100 (DI) 1.05, OPC 40001-1 (Machinery) 1.04.1, OPC 40200
(Scales) 2.00, OPC 40560 (Mining, General) 1.0.0 and OPC 40563-4 (Conveying) 1.0.0. The order never changes, so a
client may keep node identifiers over restarts.
"""

from __future__ import annotations

from asyncua import ua

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

from collections.abc import Sequence
from datetime import datetime
from enum import Enum, IntEnum
from typing import Any

class _Numbers(type):
    """Thousands of names of numbers, which the library generates."""

    def __getattr__(cls, name: str) -> int: ...

class StatusCodes(metaclass=_Numbers): ...
class ObjectIds(metaclass=_Numbers): ...
class UaError(Exception): ...

class UaStatusCodeError(UaError):
    code: int

class NodeId:
    Identifier: Any
    NamespaceIndex: int
    def __init__(self, Identifier: int | str = ..., NamespaceIndex: int = ...) -> None: ...

class QualifiedName:
    Name: str
    NamespaceIndex: int
    def __init__(self, Name: str, NamespaceIndex: int = ...) -> None: ...

class LocalizedText:
    Text: str
    def __init__(self, Text: str, Locale: str = ...) -> None: ...

class VariantType(Enum):
    Boolean = ...
    UInt16 = ...
    UInt32 = ...
    UInt64 = ...
    Double = ...
    String = ...
    NodeId = ...
    LocalizedText = ...
    ExtensionObject = ...
    value: int

class Variant:
    Value: Any
    VariantType: VariantType
    is_array: bool
    def __init__(self, Value: object, VariantType: VariantType = ..., *, is_array: bool = ...) -> None: ...

class StatusCode:
    value: int
    def __init__(self, value: int = ...) -> None: ...
    def check(self) -> None: ...
    def is_good(self) -> bool: ...
    def is_bad(self) -> bool: ...

class DataValue:
    Value: Variant
    StatusCode: StatusCode
    SourceTimestamp: datetime
    def __init__(
        self, Value: Variant, StatusCode: StatusCode = ..., SourceTimestamp: datetime | None = ...
    ) -> None: ...

class EUInformation:
    DisplayName: LocalizedText
    UnitId: int
    def __init__(
        self, NamespaceUri: str, UnitId: int, DisplayName: LocalizedText, Description: LocalizedText
    ) -> None: ...

class Range:
    def __init__(self, Low: float, High: float) -> None: ...

class Argument:
    Name: str
    Description: LocalizedText
    DataType: NodeId
    ValueRank: ValueRank

class NodeClass(IntEnum):
    DataType = ...
    Object = ...
    ObjectType = ...
    Variable = ...
    VariableType = ...
    Method = ...

class ValueRank(IntEnum):
    Scalar = ...
    OneDimension = ...

class AccessLevel(IntEnum):
    CurrentRead = ...
    HistoryRead = ...
    @property
    def mask(self) -> int: ...

class ApplicationType(IntEnum):
    Server = ...

class MessageSecurityMode(IntEnum):
    Sign = ...
    SignAndEncrypt = ...

class SecurityPolicyType(Enum):
    NoSecurity = ...
    Basic256Sha256_Sign = ...
    Basic256Sha256_SignAndEncrypt = ...

Double = float

class ExtensionObject: ...

class AttributeIds(IntEnum):
    DataTypeDefinition = ...

class StructureType(IntEnum):
    Structure = ...

class StructureField:
    Name: str
    DataType: NodeId
    ValueRank: ValueRank
    IsOptional: bool

class StructureDefinition:
    BaseDataType: NodeId
    DefaultEncodingId: NodeId
    StructureType: StructureType
    Fields: list[StructureField]

class DataTypeAttributes:
    DisplayName: LocalizedText
    IsAbstract: bool

class ObjectAttributes:
    DisplayName: LocalizedText

class ObjectTypeAttributes:
    DisplayName: LocalizedText
    IsAbstract: bool

class VariableTypeAttributes:
    DisplayName: LocalizedText
    DataType: NodeId
    ValueRank: ValueRank

class VariableAttributes:
    DisplayName: LocalizedText
    Description: LocalizedText
    Value: Variant
    DataType: NodeId
    ValueRank: ValueRank
    ArrayDimensions: list[int]
    AccessLevel: int
    UserAccessLevel: int
    Historizing: bool

class MethodAttributes:
    DisplayName: LocalizedText
    Description: LocalizedText
    Executable: bool
    UserExecutable: bool

class AddNodesItem:
    RequestedNewNodeId: NodeId
    ParentNodeId: NodeId
    BrowseName: QualifiedName
    ReferenceTypeId: NodeId
    NodeClass: NodeClass
    NodeAttributes: object
    TypeDefinition: NodeId

class AddNodesResult:
    StatusCode: StatusCode

class AddReferencesItem:
    SourceNodeId: NodeId
    TargetNodeId: NodeId
    ReferenceTypeId: NodeId
    IsForward: bool
    TargetNodeClass: NodeClass

class UserNameIdentityToken: ...
class AnonymousIdentityToken: ...
class RegisterServer2Parameters: ...

class ApplicationDescription:
    ApplicationUri: str | None

class CreateSessionParameters:
    ClientDescription: ApplicationDescription

class CreateSessionResult: ...
class ActivateSessionParameters: ...
class ActivateSessionResult: ...
class CallMethodRequest: ...
class CallMethodResult: ...

class ReadRawModifiedDetails:
    IsReadModified: bool
    StartTime: datetime
    EndTime: datetime
    NumValuesPerNode: int
    def __init__(self, IsReadModified: bool = ...) -> None: ...

class HistoryReadValueId:
    NodeId: NodeId
    ContinuationPoint: bytes | None

class HistoryReadParameters:
    HistoryReadDetails: object
    ReleaseContinuationPoints: bool
    NodesToRead: list[HistoryReadValueId]
    def __init__(self, ReleaseContinuationPoints: bool = ...) -> None: ...

class HistoryData:
    DataValues: list[DataValue]

class HistoryReadResult:
    StatusCode: StatusCode
    ContinuationPoint: bytes | None
    HistoryData: HistoryData

class HistoryUpdateParameters:
    HistoryUpdateDetails: Sequence[ExtensionObject]

class HistoryUpdateResult:
    StatusCode: StatusCode
    def __init__(self, StatusCode: StatusCode = ...) -> None: ...

def register_extension_object(
    name: str, encoding_nodeid: NodeId, class_type: type, datatype_nodeid: NodeId
) -> None: ...
def get_win_epoch() -> datetime: ...

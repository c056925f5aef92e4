"""The methods of the belt: their arguments, roles, audit, and what the plant answers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from asyncua import ua

from beltscape.core.errors import BeltscapeError
from beltscape.protocols.opcua.address_space import OWN, Builder, own_id
from beltscape.protocols.opcua.sessions import GuardedServer, find_caller
from beltscape.protocols.plant import PlantCommands, PlantUsers

_LONGEST = 200
"""Longest text of an argument, as on the operator's page."""


@dataclass(frozen=True, slots=True)
class _Method:
    """One method: its name, its arguments with their meaning, and what it calls."""

    name: str
    text: str
    arguments: tuple[tuple[str, str], ...]
    call: Callable[[PlantCommands, list[str], str], None]


_METHODS = (
    _Method(
        "AcknowledgeAlarm",
        "acknowledge an alarm",
        (("Alarm", "name of the alarm"),),
        lambda plant, texts, user: plant.acknowledge(texts[0], user),
    ),
    _Method(
        "StartBatch",
        "start a batch, such as a truck or a ship",
        (("Name", "name of the batch"), ("Product", "its product; empty: the present one")),
        lambda plant, texts, user: plant.start_batch(texts[0], texts[1], user),
    ),
    _Method("StopBatch", "stop the present batch", (), lambda plant, _, user: plant.stop_batch(user)),
    _Method(
        "ChangeProduct",
        "make a product the present one",
        (("Name", "name of the product"),),
        lambda plant, texts, user: plant.change_product(texts[0], user),
    ),
)


class CommandMethods:
    """The methods; each needs the role operator and is written to the audit log, whether it is done or refused."""

    def __init__(
        self, server: GuardedServer, builder: Builder, plant: PlantCommands, users: PlantUsers
    ) -> None:
        """Add the methods below the belt."""
        self._server, self._plant, self._users = server, plant, users
        for method in _METHODS:
            node = own_id(f"Belt.Commands.{method.name}")
            inputs = [_make_argument(name, text) for name, text in method.arguments]
            name = ua.QualifiedName(method.name, OWN)
            builder.add_method(node, own_id("Belt.Commands"), name, inputs, method.text)
            server.isession.add_method_callback(node, self._make_callback(method))

    async def acknowledge(self, alarm: str) -> ua.StatusCode:
        """Acknowledge an alarm in the caller's name."""
        return await self._run(_METHODS[0], [alarm])

    def _make_callback(self, method: _Method) -> Callable[..., object]:
        async def callback(_parent: ua.NodeId, *arguments: ua.Variant) -> ua.StatusCode:
            texts = [argument.Value for argument in arguments]
            if len(texts) != len(method.arguments):
                missing = len(texts) < len(method.arguments)
                codes = ua.StatusCodes
                return ua.StatusCode(codes.BadArgumentsMissing if missing else codes.BadTooManyArguments)
            if any(not isinstance(text, str) or len(text) > _LONGEST for text in texts):
                return ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
            return await self._run(method, texts)

        return callback

    async def _run(self, method: _Method, texts: list[str]) -> ua.StatusCode:
        caller = find_caller()
        detail = {name: text for (name, _), text in zip(method.arguments, texts, strict=True)}
        if not await asyncio.to_thread(self._users.has_role, caller.user, "operator"):
            return await self._refuse(
                method, detail, "needs the role operator", ua.StatusCodes.BadUserAccessDenied
            )
        try:
            await asyncio.to_thread(method.call, self._plant, texts, caller.user)
        except BeltscapeError as error:
            return await self._refuse(method, detail, str(error), ua.StatusCodes.BadInvalidState)
        await self._audit(method.name, detail)
        return ua.StatusCode(ua.StatusCodes.Good)

    async def _refuse(
        self, method: _Method, detail: dict[str, str], reason: str, status: int
    ) -> ua.StatusCode:
        """Show why a command was refused, which a status alone does not say."""
        await self._audit(f"{method.name} refused", {**detail, "reason": reason})
        text = ua.DataValue(
            ua.Variant(f"{method.name}: {reason}", ua.VariantType.String), SourceTimestamp=datetime.now(UTC)
        )
        await self._server.write_attribute_value(own_id("Belt.Commands.LastRefusal"), text)
        return ua.StatusCode(status)

    async def _audit(self, action: str, detail: dict[str, str]) -> None:
        caller = find_caller()
        write = self._users.write_audit
        await asyncio.to_thread(write, f"opcua {action}", caller.user or "anonymous", caller.address, detail)


def _make_argument(name: str, text: str) -> ua.Argument:
    argument = ua.Argument()
    argument.Name, argument.Description = name, ua.LocalizedText(text)
    argument.DataType, argument.ValueRank = ua.NodeId(ua.ObjectIds.String), ua.ValueRank.Scalar
    return argument

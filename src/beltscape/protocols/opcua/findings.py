"""The newest finding of every check of the system about itself, as variables below the belt's health."""

from __future__ import annotations

import math

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from beltscape.core.live.findings import Finding
from beltscape.protocols.opcua.model.builder import Builder
from beltscape.protocols.opcua.model.namespaces import OWN, own_id
from beltscape.protocols.opcua.publication import to_datetime
from beltscape.protocols.plant import PlantState

_MOST = 300
"""Checks that are served, which bounds the address space; a rig of eight cameras has some 60."""


class Findings:
    """One variable for every check, with its limit, σ, unit, and the fault in words."""

    def __init__(self, server: InternalServer, builder: Builder) -> None:
        """Begin without checks; they are added when they are first made."""
        self._server, self._builder = server, builder
        self._shown: dict[str, Finding] = {}

    async def update(self, state: PlantState) -> None:
        """Show the findings that are new or have changed."""
        for finding in state.findings:
            name = f"{finding.check}.{finding.subject}" if finding.subject else finding.check
            if name not in self._shown:
                if len(self._shown) >= _MOST:
                    continue
                self._add(name)
            elif self._shown[name] is finding:
                continue
            self._shown[name] = finding
            for node, value in _list_values(name, finding).items():
                value.SourceTimestamp = to_datetime(state.wall_ns)
                await self._server.write_attribute_value(own_id(node), value)

    def _add(self, name: str) -> None:
        path = f"Belt.Monitoring.Health.{name}"
        node, parent = own_id(path), own_id("Belt.Monitoring.Health")
        value = ua.Variant(0.0, ua.VariantType.Double)
        self._builder.add_variable(node, parent, ua.QualifiedName(name, OWN), value, text="value of a check")
        for key in ("Sigma", "Limit"):
            self._builder.add_property(own_id(f"{path}.{key}"), node, ua.QualifiedName(key, OWN), value)
        for key in ("Unit", "Fault", "Effect"):
            text = ua.Variant("", ua.VariantType.String)
            self._builder.add_property(own_id(f"{path}.{key}"), node, ua.QualifiedName(key, OWN), text)


def _list_values(name: str, finding: Finding) -> dict[str, ua.DataValue]:
    path = f"Belt.Monitoring.Health.{name}"
    texts = {"Unit": finding.unit, "Fault": str(finding.text), "Effect": finding.effect}
    return {
        path: _make_number(finding.value),
        f"{path}.Sigma": _make_number(finding.sigma),
        f"{path}.Limit": _make_number(finding.limit),
        **{
            f"{path}.{key}": ua.DataValue(ua.Variant(text, ua.VariantType.String))
            for key, text in texts.items()
        },
    }


def _make_number(value: float) -> ua.DataValue:
    """Return a number; its status is bad where it was not measured, or there is none."""
    good, bad = ua.StatusCodes.Good, ua.StatusCodes.BadWaitingForInitialData
    status = ua.StatusCode(good if math.isfinite(value) else bad)
    return ua.DataValue(ua.Variant(value, ua.VariantType.Double), status)

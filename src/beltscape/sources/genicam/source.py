"""Cameras as a live source."""

from __future__ import annotations

from collections.abc import Mapping

from beltscape.core.live import LiveSource
from beltscape.sources.genicam.settings import CamerasSettings


def open_cameras(
    settings: CamerasSettings, core: str, sizes_px: Mapping[str, tuple[int, int]] | None = None
) -> LiveSource:
    """Start the cameras of ``settings``; those that are not there are looked for as long as it runs.

    ``core`` is the rig's core camera; ``sizes_px`` the (width, height) that each camera's images must have.
    SettingsError where Aravis is not installed or ``core`` is not among the cameras.
    """
    raise NotImplementedError  # comes with the next commits

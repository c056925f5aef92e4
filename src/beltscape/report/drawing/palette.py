"""The colour palette of pages and charts by role, for light and dark backgrounds."""

from __future__ import annotations

from collections.abc import Mapping

ROLES: Mapping[str, tuple[str, str]] = {
    "ink": ("#1b1f24", "#e6e9ec"),
    "quiet": ("#5c6670", "#a3adb8"),
    "grid": ("#e1e5e9", "#3a424b"),
    "paper": ("#ffffff", "#1b2026"),
    "ground": ("#f3f4f6", "#12161a"),
    "line": ("#dde1e6", "#343c45"),
    "accent": ("#c2410c", "#ff9a62"),
    "warning": ("#b36b00", "#f0b24a"),
    "core": ("#cb4209", "#ff8c4d"),
    "auxiliary": ("#1864ab", "#6cb6ff"),
    "board": ("#a0a8b1", "#7b8590"),
    "first": ("#0b62a4", "#64b2f5"),
    "second": ("#c75000", "#ff9d52"),
    "third": ("#7a3e9d", "#cf9cf0"),
    "fourth": ("#4f5962", "#b8c1ca"),
    "band": ("#a9cff0", "#2b5a84"),
    "reference": ("#87919b", "#7f8a95"),
    "limit": ("#b5179e", "#ff79d4"),
    "belt": ("#c4cad1", "#4a545e"),
    "load": ("#ecd3a8", "#6b5635"),
    "common": ("#00795a", "#3fcfa3"),
    "shared": ("#c4e3d9", "#1d4b3f"),
    "measured": ("#008060", "#2fc796"),
    "degraded": ("#c98a00", "#f2bd3e"),
    "bridged": ("#0068a8", "#5bb4f0"),
    "missing": ("#cc4c00", "#ff8046"),
}
"""Role → colour on a light ground, colour on a dark ground. No two roles share a light colour: charts are drawn with
these and their colours replaced by the role's CSS variable. The four states are Okabe and Ito's bluish green, orange,
blue and vermilion, darkened or lightened to a contrast of 3 with the ground."""

_NAMES = {light: role for role, (light, _) in ROLES.items()}


def light(role: str) -> str:
    """Return the "#rrggbb" of a role on a light ground."""
    return ROLES[role][0]


def css_color(color: str) -> str:
    """Return the CSS variable of a role's light colour; any other colour unchanged."""
    role = _NAMES.get(color.lower())
    return color if role is None else variable(role)


def variable(role: str) -> str:
    """Return the CSS variable of a role."""
    return f"var(--c-{role})"


def css_variables(*, dark: bool) -> str:
    """Return the declarations of all roles' variables."""
    return " ".join(f"--c-{role}: {colors[dark]};" for role, colors in ROLES.items())

"""The plots of a calibration's report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltscape.calibrate.score import Evidence
from beltscape.calibrate.uncertainty import DepthSigma
from beltscape.core.camera import Camera
from beltscape.core.rig import Rig
from beltscape.report.plots import panels, to_png


def depth_sigma_plot(maps: Sequence[DepthSigma]) -> bytes:
    """σ of depth over the core camera's view, at each distance."""
    top = max(float(np.nanquantile(m.sigma_mm, 0.98)) for m in maps)
    figure, axes = panels(len(maps), columns=3, width=3.9, height=3.1)
    image = None
    for axis, m in zip(axes, maps, strict=True):
        extent = (m.x_mm[0], m.x_mm[-1], m.y_mm[-1], m.y_mm[0])
        image = axis.imshow(m.sigma_mm, extent=extent, cmap="viridis", vmin=0, vmax=top)
        axis.set(
            title=f"{m.depth_mm:.0f} mm: median {np.nanmedian(m.sigma_mm):.3f} mm",
            xlabel="x, mm",
            ylabel="y, mm",
        )
    if image is not None:
        figure.colorbar(image, ax=axes, label="σ of depth, mm", shrink=0.75)
    return to_png(figure)


def _frame_axes(axis, camera: Camera, title: str) -> None:
    width, height = camera.size_px
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", title=title)
    axis.spines[["top", "right"]].set_visible(True)
    axis.set_xticks([0, width - 1])
    axis.set_yticks([0, height - 1])


def coverage_plot(rig: Rig, evidence: Evidence) -> bytes:
    """Corners in each camera's image, coloured by their reprojection error."""
    cameras = rig.cameras
    top = float(np.quantile(np.linalg.norm(evidence.errors_px(), axis=1), 0.98))
    figure, axes = panels(len(cameras), columns=3, width=3.7, height=3.2)
    scatter = None
    for axis, (name, camera) in zip(axes, cameras.items(), strict=True):
        views = evidence.residuals[name].values()
        pixels = np.concatenate([np.empty((0, 2)), *(v.pixels for v in views)])
        errors = np.concatenate([np.empty((0, 2)), *(v.errors_px for v in views)])
        scatter = axis.scatter(
            pixels[:, 0],
            pixels[:, 1],
            c=np.linalg.norm(errors, axis=1),
            s=4,
            cmap="viridis_r",
            vmin=0,
            vmax=top,
        )
        _frame_axes(axis, camera, f"{name}: {len(pixels)} corners")
    if scatter is not None:
        figure.colorbar(scatter, ax=axes, label="reprojection error, px", shrink=0.6)
    return to_png(figure)


def residual_plot(rig: Rig, evidence: Evidence) -> tuple[bytes, str]:
    """Residual arrows in each camera's image, and the caption that says how far they are magnified."""
    cameras = rig.cameras
    median = float(np.median(np.linalg.norm(evidence.errors_px(), axis=1)))
    magnify = 0.02 * max(max(c.size_px) for c in cameras.values()) / max(median, 1e-6)
    figure, axes = panels(len(cameras), columns=3, width=3.7, height=3.2)
    for axis, (name, camera) in zip(axes, cameras.items(), strict=True):
        views = evidence.residuals[name].values()
        pixels = np.concatenate([np.empty((0, 2)), *(v.pixels for v in views)])
        errors = np.concatenate([np.empty((0, 2)), *(v.errors_px for v in views)])
        axis.quiver(
            pixels[:, 0], pixels[:, 1], errors[:, 0], errors[:, 1], angles="xy", scale_units="xy",
            scale=1 / magnify, width=0.0022, color="#1864ab",
        )  # fmt: skip
        rms = float(np.sqrt((errors**2).sum(axis=1).mean())) if len(errors) else float("nan")
        _frame_axes(axis, camera, f"{name}: RMS {rms:.3f} px")
    return to_png(figure), f"Residuals, magnified {magnify:.0f} times."

"""What the monitor finds in the images of a moving belt, and after how many frames."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.health.images.monitor import ImageCheck, ImageMonitor
from beltscape.health.settings import HealthSettings
from tests.health.images.speckled_belt import AMBIENT, Levels, add_noise, blur, make_frame, make_rig
from tests.thorough import list_cases

LEARNING, CORE, AUXILIARY = 5, "cam0", "cam3"


def make_monitor(**settings: object) -> ImageMonitor:
    return ImageMonitor(make_rig(), HealthSettings(learning_frames=LEARNING, **settings))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def learned() -> ImageMonitor:
    one = make_monitor()
    for number in range(LEARNING + 1):
        assert_sound(one.check_images(make_frame(number)))
    return one


@pytest.fixture
def monitor(learned: ImageMonitor) -> ImageMonitor:
    """Return a monitor that has learned its reference values."""
    return deepcopy(learned)


def assert_sound(check: ImageCheck) -> None:
    assert [one.text for one in check.findings if one.is_fault] == []
    assert check.is_whole


def of_camera(camera: str, change: Callable[[Levels], Levels]) -> Callable[[str, Levels], Levels]:
    return lambda name, light: change(light) if name == camera else light


def name_faults(findings: tuple[Finding, ...]) -> set[str]:
    return {f"{one.check}:{one.subject}".rstrip(":") for one in findings if one.is_fault}


def veil(light: Levels) -> Levels:
    return (0.4 * light + 0.6 * blur(light, 60)).astype(np.float32)


NEXT = LEARNING + 1


class TestOneCamera:
    @pytest.mark.parametrize("camera", [CORE, AUXILIARY])
    @pytest.mark.parametrize(
        ("change", "check"),
        [
            (lambda light: blur(light, 1.0), "defocus"),
            (lambda light: blur(light, 2.0), "defocus"),
            (lambda light: blur(light, 4.0), "defocus"),
            (veil, "condensation"),
            (lambda light: 0.02 * light, "lens_covered"),
            (lambda light: 20 * light, "overexposure"),
            (lambda light: 4 * light, "exposure"),
            (lambda light: 0.3 * light, "exposure"),
        ],
    )
    def test_fault_is_named_in_its_first_frame(
        self, monitor: ImageMonitor, camera: str, change: Callable[[Levels], Levels], check: str
    ) -> None:
        result = monitor.check_images(make_frame(NEXT, of_camera(camera, change)))

        assert f"{check}:{camera}" in name_faults(result.findings)
        assert all(one.subject == camera for one in result.findings if one.effect != "none")
        assert any(one.effect != "none" for one in result.findings)

    def test_lost_core_leaves_nothing_to_match(self, monitor: ImageMonitor) -> None:
        result = monitor.check_images(make_frame(NEXT, of_camera(CORE, lambda light: blur(light, 4.0))))

        assert not result.frames.images

    def test_covered_auxiliary_is_left_out(self, monitor: ImageMonitor) -> None:
        result = monitor.check_images(make_frame(NEXT, of_camera(AUXILIARY, lambda light: 0 * light)))

        assert AUXILIARY not in result.frames.images
        assert len(result.frames.images) == 4
        assert not result.is_whole
        assert {one.effect for one in result.findings if one.is_fault} == {"degraded"}

    def test_blur_from_the_first_frame_on_is_not_learned_as_sound(self) -> None:
        one = make_monitor()
        for number in range(LEARNING + 3):
            result = one.check_images(make_frame(number, of_camera(CORE, lambda light: blur(light, 2.0))))
            assert "defocus:cam0" in name_faults(result.findings)


def test_a_camera_that_missed_some_frames_is_learned() -> None:
    one = make_monitor()
    for number in range(LEARNING):
        frames = make_frame(number)
        present = {name: image for name, image in frames.images.items() if name != AUXILIARY or number != 2}
        one.check_images(replace(frames, images=present))
    assert one.reference is not None
    assert set(one.reference.cameras) == set(make_rig().cameras)


class TestFrozen:
    @pytest.mark.parametrize("camera", [CORE, AUXILIARY])
    def test_first_repeated_image_is_noticed(self, monitor: ImageMonitor, camera: str) -> None:
        now, before = make_frame(NEXT), make_frame(LEARNING)
        result = monitor.check_images(replace(now, images={**now.images, camera: before.images[camera]}))

        assert name_faults(result.findings) == {f"frozen_image:{camera}"}

    def test_repeated_image_with_new_noise_is_noticed_while_the_belt_moves(
        self, monitor: ImageMonitor
    ) -> None:
        now, before = make_frame(NEXT), make_frame(LEARNING)
        noisy = add_noise(before.images[CORE].astype(np.float32), (77, 7))
        result = monitor.check_images(replace(now, images={**now.images, CORE: noisy}))

        assert "frozen_image:cam0" in name_faults(result.findings)

    def test_all_images_repeated(self, monitor: ImageMonitor) -> None:
        result = monitor.check_images(replace(make_frame(LEARNING), frame="again"))

        frozen = [one for one in result.findings if one.check == "frozen_image" and one.is_fault]
        assert len(frozen) == 5 and all(one.is_momentary for one in frozen)
        assert not result.frames.images

    def test_a_recorded_frame_shown_again_in_a_loop_is_not_frozen(self, monitor: ImageMonitor) -> None:
        for number in (NEXT, NEXT, NEXT + 1):
            assert_sound(monitor.check_images(replace(make_frame(number), recorded=str(number))))

    def test_standing_belt_is_not_frozen(self) -> None:
        one = make_monitor()
        for number in range(LEARNING + 3):
            assert_sound(one.check_images(make_frame(number, standing=True)))


class TestLight:
    def test_projector_off_leaves_nothing_to_match(self, monitor: ImageMonitor) -> None:
        result = monitor.check_images(
            make_frame(NEXT, lambda _, light: np.asarray(np.minimum(blur(light, 5) / 4, AMBIENT), np.float32))
        )

        assert "projector" in name_faults(result.findings)
        assert not result.frames.images

    def test_projector_dim(self, monitor: ImageMonitor) -> None:
        def dim(_: str, light: Levels) -> Levels:
            return np.asarray(np.minimum(light, AMBIENT) + 0.3 * np.maximum(light - AMBIENT, 0), np.float32)

        result = monitor.check_images(make_frame(NEXT, dim))

        assert "projector" in name_faults(result.findings)

    @pytest.mark.parametrize("dark", [slice(None, 240), slice(300, None)])
    def test_a_dark_part_of_the_pattern_is_no_defocus(self, monitor: ImageMonitor, dark: slice) -> None:
        def darken(_: str, light: Levels) -> Levels:
            off, columns = np.minimum(blur(light, 5) / 4, AMBIENT), np.arange(light.shape[1])
            return np.where(np.isin(columns, columns[dark]), off, light).astype(np.float32)

        result = monitor.check_images(make_frame(NEXT, darken))
        (fault,) = [one for one in result.findings if one.is_fault and one.check != "lamp"]
        assert (fault.check, fault.cause, fault.effect) == ("projector", "projector_part", "degraded")

    def test_projector_out_of_focus(self, monitor: ImageMonitor) -> None:
        result = monitor.check_images(make_frame(NEXT, lambda _, light: blur(light, 1.2)))

        assert "projector_focus" in name_faults(result.findings)

    def test_dust_in_the_air(self, monitor: ImageMonitor) -> None:
        result = monitor.check_images(
            make_frame(NEXT, lambda _, light: (0.5 * light + 20).astype(np.float32))
        )

        assert "dust" in name_faults(result.findings)

    def test_dust_where_no_pattern_is_resolved(self) -> None:
        """The veil takes the same share of all contrast and brightens the dark blocks; an empty belt does not."""

        def soften(_: str, light: Levels) -> Levels:
            return np.asarray(0.25 * light + 0.75 * blur(light, 9.0), np.float32)

        def veil(name: str, light: Levels) -> Levels:
            return np.asarray(0.5 * soften(name, light) + 0.6 * light.mean(), np.float32)

        def empty(name: str, light: Levels) -> Levels:
            bare = light.copy()
            bare[:, 80:320] = light[:, np.arange(80, 320) % 60 + 15]
            return soften(name, bare)

        monitor = make_monitor()
        for number in range(LEARNING + 2):
            assert_sound(monitor.check_images(make_frame(number, soften)))
        assert monitor.reference is not None and not monitor.reference.has_speckle
        veiled = monitor.check_images(make_frame(NEXT, veil)).findings
        assert [(one.check, one.effect) for one in veiled if one.is_fault] == [("dust", "degraded")]
        assert "dust" not in name_faults(monitor.check_images(make_frame(NEXT, empty)).findings)

    def test_sunlight_patch_has_a_place(self, monitor: ImageMonitor) -> None:
        def shine(_: str, light: Levels) -> Levels:
            lit = light.copy()
            lit[100:200, 150:260] += 130
            return lit

        findings = monitor.check_images(make_frame(NEXT, shine)).findings
        (sun,) = [one for one in findings if one.check == "sunlight"]

        assert sun.effect == "degraded"
        assert sun.place is not None
        left, top, right, bottom = sun.place
        assert 0.3 < left < 0.45
        assert 0.6 < right < 0.72
        assert 0.25 < top < 0.4
        assert 0.55 < bottom < 0.7

    def test_sunlight_on_a_pattern_too_fine_to_be_recognised(self) -> None:
        """A project that states its projector needs no recognised pattern; the sun's light is no dirt."""

        def shine(_: str, light: Levels) -> Levels:
            lit = 0.25 * light + 0.75 * blur(light, 9.0)
            lit[100:200, 150:260] += 130 * (number > LEARNING)
            return lit.astype(np.float32)

        monitor = make_monitor(projector="yes")
        checks: list[ImageCheck] = []
        for number in range(LEARNING + 2):
            checks.append(monitor.check_images(make_frame(number, shine)))
        assert monitor.reference is not None
        assert not monitor.reference.has_speckle
        assert "sunlight" in name_faults(checks[-1].findings)
        assert monitor.check_depth(checks[-1], None) == ()  # type: ignore[arg-type]  # not even looked at

    def test_flicker_is_only_a_warning(self, monitor: ImageMonitor) -> None:
        result = monitor.check_images(make_frame(NEXT, lambda _, light: 1.3 * light))
        assert name_faults(result.findings) == {"flicker"}
        assert result.frames.images

    def test_dark_material_is_not_a_dim_projector(self, monitor: ImageMonitor) -> None:
        def darken(_: str, light: Levels) -> Levels:
            coal = light.copy()
            coal[:, 80:320] *= 0.3
            return coal

        for number in range(NEXT, NEXT + 3):
            result = monitor.check_images(make_frame(number, darken))
            assert not {"projector", "projector_focus", "dust", "lamp"} & name_faults(result.findings)

    def test_project_without_projector_is_not_accused(self) -> None:
        one = make_monitor(projector="no")
        for number in range(LEARNING + 3):
            assert_sound(one.check_images(make_frame(number, speckle=False)))


def test_same_frames_give_the_same_findings() -> None:
    frames = [make_frame(number) for number in range(3)]

    def run(sets: list[FrameSet]) -> list[str]:
        one = make_monitor()
        return [repr(one.check_images(each).findings) for each in sets]

    assert run(frames) == run(frames)


def test_checks_can_be_switched_off() -> None:
    assert make_monitor(images=False).check_images(make_frame(0)).findings == ()


class TestExposureChange:
    """Exposure times that the system changes itself are no fault of the light."""

    @staticmethod
    def expose(number: int, factor: float, exposures_us: float | None = None) -> FrameSet:
        frames = make_frame(number, lambda _, light: (0.6 * factor * light).astype(np.float32))
        given = 1000 * factor if exposures_us is None else exposures_us
        return replace(frames, exposures_us=dict.fromkeys(frames.images, given))

    def run(self, monitor: ImageMonitor, factor: float, exposure_us: float | None = None) -> set[str]:
        for number in range(LEARNING + 1):
            assert_sound(monitor.check_images(self.expose(number, 1.0)))
        found = set[str]()
        for number in range(NEXT, NEXT + 4):
            found |= name_faults(monitor.check_images(self.expose(number, factor, exposure_us)).findings)
        return found

    @pytest.mark.parametrize("factor", list_cases([0.6, 1.5], [1.5]))
    def test_known_change_is_no_flicker_and_no_ageing(self, factor: float) -> None:
        assert self.run(make_monitor(), factor) == set()

    def test_change_of_the_light_itself_is_still_found(self) -> None:
        assert "flicker" in self.run(make_monitor(), 0.4, 1000.0)

    def test_images_of_unknown_exposure_are_not_compared(self) -> None:
        monitor = make_monitor()
        assert self.run(monitor, 1.5, float("nan")) == set()
        assert_sound(monitor.check_images(self.expose(NEXT + 4, 1.5)))

    def test_reference_learned_over_a_change_holds(self) -> None:
        monitor = make_monitor()
        for number in range(LEARNING + 1):
            assert_sound(monitor.check_images(self.expose(number, 1.0 if number < 2 else 1.4)))
        assert_sound(monitor.check_images(self.expose(NEXT, 0.7)))

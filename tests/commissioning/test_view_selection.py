"""Views of the board are taken by themselves: still, sharp, well-lit and new ones, and no others."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection.detect_capture import list_variants, make_two_sided_detector
from beltscape.core.frames import Image
from beltscape.core.geometry.pose import Pose
from beltscape.pipeline.calibrating.view_selection import ViewSelector, measure_print
from tests.synthetic.boards import Print, board_poses, facing, row_of_cameras, view

NAMES = ("cam0", "cam1")


@pytest.fixture(scope="module")
def detect(charuco):
    return make_two_sided_detector(charuco, list_variants(charuco)[0])


class Hand:
    """Holds the board below two cameras and shows what they see to a selector."""

    def __init__(self, charuco, detect) -> None:
        self.board, self.detect = charuco, detect
        self.rig = row_of_cameras(NAMES)
        self.selector = ViewSelector(charuco)
        self.seed = 0

    def render(self, pose: Pose, cameras=NAMES) -> dict[str, Image]:
        self.seed += 1
        how = Print(seed=self.seed)
        return {
            name: view(self.rig.cameras[name], self.rig.cam_from_core[name] @ pose, self.board, how)
            for name in cameras
        }

    def show(self, images: dict[str, Image]) -> str:
        found = {name: self.detect(image) for name, image in images.items()}
        return self.selector.assess(images, {name: own for name, own in found.items() if own}).verdict

    def hold(self, pose: Pose) -> list[str]:
        return [self.show(self.render(pose)) for _ in range(2)]


@pytest.fixture
def hand(charuco, detect) -> Hand:
    return Hand(charuco, detect)


def move(pose: Pose, x_mm: float) -> Pose:
    return replace(pose, translation_mm=pose.translation_mm + np.array([x_mm, 0, 0]))


def test_a_view_at_rest_is_taken_once_and_another_one_again(hand):
    first, second = board_poses(hand.board, 2)
    assert hand.hold(first) == ["moving", "taken"]
    assert hand.hold(first) == ["known", "known"]
    assert hand.hold(second) == ["moving", "taken"]
    assert hand.selector.taken == 2


def test_a_moving_board_is_not_taken_however_sharp(hand):
    (pose,) = board_poses(hand.board, 1)
    verdicts = [hand.show(hand.render(move(pose, 2.0 * i))) for i in range(4)]
    assert verdicts == ["moving"] * 4
    assert hand.hold(pose) == ["moving", "taken"]


def test_one_camera_is_not_enough_and_no_board_is_said(hand):
    (pose,) = board_poses(hand.board, 1)
    images = hand.render(pose)
    images["cam1"] = np.full_like(images["cam1"], 90)
    assert hand.show(images) == "one_camera"
    assert hand.show({name: np.full_like(image, 90) for name, image in images.items()}) == "no_board"


def test_blur_that_the_hand_makes_is_named(hand):
    near = facing(hand.board, distance_mm=400, tilt=0.1)
    hand.hold(near)
    turned = facing(hand.board, distance_mm=400, tilt=0.4)
    blurred = [
        {n: np.asarray(cv2.blur(image, (7, 1)), np.uint8) for n, image in hand.render(turned).items()}
        for _ in range(2)
    ]
    assert [hand.show(images) for images in blurred] == ["moving", "blurred"]


@pytest.mark.parametrize(("gain", "level", "verdict"), [(0.1, 2, "dark"), (1.6, 60, "bright")])
def test_wrong_light_is_named(hand, gain, level, verdict):
    pose = facing(hand.board, distance_mm=450)
    shown = [
        {
            n: np.clip(gain * image.astype(float) + level, 0, 255).astype(np.uint8)
            for n, image in hand.render(pose).items()
        }
        for _ in range(2)
    ]
    assert [hand.show(images) for images in shown] == ["moving", verdict]


def test_views_taken_earlier_are_known(hand):
    (pose,) = board_poses(hand.board, 1)
    images = hand.render(pose)
    sizes = {name: (image.shape[1], image.shape[0]) for name, image in images.items()}
    corners = {name: hand.detect(image) for name, image in images.items()}
    hand.selector.remember(corners, sizes)
    assert hand.hold(pose) == ["moving", "known"]


def test_the_width_of_an_edge_follows_the_blur(charuco, detect):
    rig = row_of_cameras(NAMES)
    pose, widths = facing(charuco, distance_mm=350, tilt=0.0), []
    for blur in (0.5, 1.0, 1.6):
        image = view(rig.cameras["cam0"], pose, charuco, Print(blur_px=blur, noise=0.5))
        widths.append(measure_print(image, detect(image)).edge_px)
    assert widths == sorted(widths)
    # a step blurred by a Gaussian rises by its height over sqrt(2 pi) sigma
    assert widths[2] == pytest.approx(np.sqrt(2 * np.pi) * 1.6, rel=0.3)

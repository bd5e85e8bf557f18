"""One scene from one seed: a picture with a target or without, and the true boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector_training.scenes import light, occluders, sensor
from detector_training.scenes.backdrop import Library, random_backdrop
from detector_training.scenes.geometry import Flat, Geometry
from detector_training.scenes.hang import Board, hang_lookalike, hang_target, hang_wall
from detector_training.scenes.image import LinearImage, Mask
from detector_training.scenes.labels import LabelledBox, label_boxes
from detector_training.scenes.placement import Placement, random_camera, random_placement
from detector_training.scenes.projection import image_from_board, square_box
from detector_training.scenes.recipe import Plan, Recipe, choose_plan
from detector_training.scenes.relief import Relief, random_relief
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.target import Target

FAR_PX, CLOSE_PX, TILTED_DEG = 40.0, 300.0, 40.0
"""From where on a view counts as far, close, or tilted."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A labelled picture."""

    jpeg: bytes
    width: int
    height: int
    recipe: Recipe
    """What it was made to show; ``MIXED``: several conditions at once."""
    conditions: tuple[str, ...]
    boxes: tuple[LabelledBox, ...]
    """Empty for a negative."""
    camera: CameraIntrinsics
    camera_from_target: Pose | None
    geometry: Geometry

    def label(self, image: str) -> dict[str, Any]:
        """The line of ``labels.jsonl`` for the picture stored as ``image``."""
        distance = None
        if self.boxes and self.camera_from_target is not None:
            distance = round(float(np.linalg.norm(self.camera_from_target.translation)), 4)
        return {
            "image": image,
            "width": self.width,
            "height": self.height,
            "kind": "scene" if self.boxes else "negative",
            "recipe": str(self.recipe),
            "conditions": list(self.conditions),
            "distance_m": distance,
            "boxes": [
                {
                    "level": str(b.level),
                    "xyxy": [round(v, 3) for v in b.xyxy],
                    "visible": round(b.visible, 4),
                }
                for b in self.boxes
            ],
        }

    def view(self) -> dict[str, Any]:
        """What a label needs beside its depth picture: the camera, and where the target truly is.

        ``camera_from_target`` is a 4x4 matrix; target frame: x out of the board, z up along it.
        """
        c, pose = self.camera, self.camera_from_target
        return {
            "camera": {"fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy},
            "camera_from_target": None if pose is None else pose.matrix.round(9).tolist(),
        }


def generate(
    seed: tuple[int, ...],
    library: Library,
    target: Target,
    recipe: Recipe = Recipe.MIXED,
    board: Board | None = None,
    plan: Plan | None = None,
) -> Scene:
    """The scene of a seed; the same bytes for the same seed and background files.

    Args:
        seed: source of all chance.
        library: the background pictures that may be used.
        target: what is to be found.
        recipe: what the picture shall show.
        board: draws another print in the target's place; pose, light and wear stay the same.
        plan: what chance may do, in the place of the recipe's own plan.

    Raises:
        SceneError: the plan has no place for the target.
    """
    rng = np.random.default_rng(seed)
    if plan is None:
        recipe, plan = choose_plan(rng, recipe)
    camera = random_camera(rng) if plan.camera is None else plan.camera
    backdrop = random_backdrop(rng, library, camera)
    image = backdrop.image.copy()
    conditions: list[str] = []
    pose: Pose | None = None
    if rng.random() >= plan.negative:
        where = Placement(
            plan.board_px, plan.distance_m, plan.tilt_deg, plan.cut, plan.any_roll, plan.whole
        )
        pose = random_placement(rng, camera, target.board_side_m, where)
    shading = light.shading(rng, camera.height, camera.width)
    if rng.random() < 0.4:
        image *= shading[..., None]
    wall, lookalikes = _hang_lookalikes(
        rng, image, library, target, camera, pose, shading, plan, conditions
    )
    hung: Flat | None = None
    relief: Relief | None = None
    if pose is not None:
        if rng.random() < plan.relief:
            relief = random_relief(rng, target.board_side_m)
        hung = hang_target(
            rng, image, library, target, camera, pose, shading, plan, relief, board, conditions
        )
    if rng.random() < plan.shadow:
        image *= light.cast_shadow(rng, camera.height, camera.width)[..., None]
        conditions.append("shadow")
    covers = _occlude(rng, image, library, target, camera, pose, plan, conditions)
    if rng.random() < plan.flare:
        light.flare(rng, image)
        conditions.append("flare")
    rgb = _photograph(rng, image, _disc_px(target, camera, pose), plan, conditions)
    boxes = (
        () if pose is None else label_boxes(target, camera, pose, _hidden(covers, camera), relief)
    )
    if boxes and pose is not None:
        _note_view(conditions, boxes, pose)
    quality = int(rng.integers(plan.quality[0], plan.quality[1] + 1))
    return Scene(
        sensor.jpeg(rgb, quality),
        camera.width,
        camera.height,
        recipe,
        tuple(dict.fromkeys(conditions)),
        boxes,
        camera,
        pose if boxes else None,
        Geometry(camera, backdrop.depth_m, backdrop.flat, wall, lookalikes, hung, relief, covers),
    )


def _hang_lookalikes(
    rng: np.random.Generator,
    image: LinearImage,
    library: Library,
    target: Target,
    camera: CameraIntrinsics,
    pose: Pose | None,
    shading: Mask,
    plan: Plan,
    conditions: list[str],
) -> tuple[Flat | None, tuple[Flat, ...]]:
    """Hang the wall behind the target and what is beside it, in place; gives where they are."""
    wall: Flat | None = None
    count = int(rng.poisson(plan.lookalikes if pose is not None else plan.lookalikes_alone))
    if pose is None:
        count = max(count, plan.lookalikes_least)
    elif rng.random() < plan.wall:
        wall = hang_wall(rng, image, library, camera, pose, shading)
        conditions.append("wall")
    things = [hang_lookalike(rng, image, target, camera, shading) for _ in range(count)]
    if count:
        conditions.append("lookalike")
    return wall, tuple(thing for thing in things if thing is not None)


def _occlude(
    rng: np.random.Generator,
    image: LinearImage,
    library: Library,
    target: Target,
    camera: CameraIntrinsics,
    pose: Pose | None,
    plan: Plan,
    conditions: list[str],
) -> tuple[Mask, ...]:
    """Put things in front, in place; gives how much of each pixel (H, W) each of them hides."""
    shape = (camera.height, camera.width)
    things = []
    if rng.random() < plan.occluder:
        if pose is None:
            box = (200.0, 150.0, 400.0, 350.0)
        else:
            box = square_box(image_from_board(camera, pose), target.board_side_m)
        things.append(occluders.random_occluder(rng, library, shape, box))
        conditions.append("obstruction")
    if rng.random() < plan.arm:
        things.append(occluders.contact_arm(rng, shape))
        conditions.append("arm")
    for thing in things:
        level = np.float32(np.exp(rng.normal(0, 0.5)) * max(float(image[::8, ::8].mean()), 0.02))
        colour = thing.colour * (level / max(float(thing.colour[::8, ::8].mean()), 0.02))
        cover = thing.cover[..., None]
        image += cover * (colour - image)
    return tuple(thing.cover for thing in things)


def _hidden(covers: tuple[Mask, ...], camera: CameraIntrinsics) -> Mask:
    """How much of each pixel (H, W) things in front hide together."""
    hidden = np.zeros((camera.height, camera.width), dtype=np.float32)
    for cover in covers:
        hidden += (1 - hidden) * cover
    return hidden


def _disc_px(target: Target, camera: CameraIntrinsics, pose: Pose | None) -> float:
    """Apparent diameter of the outer disc; of one in the middle distance where there is none."""
    if pose is None:
        return 60.0
    return camera.fx * target.discs[0].diameter_m / float(np.linalg.norm(pose.translation))


def _photograph(
    rng: np.random.Generator,
    image: LinearImage,
    readable_px: float,
    plan: Plan,
    conditions: list[str],
) -> NDArray[np.uint8]:
    exposed = sensor.random_exposure(rng, sensor.vignette(rng, image), plan, conditions)
    optics = sensor.random_optics(rng, exposed, readable_px, plan, conditions)
    return sensor.develop(rng, optics, plan, conditions)


def _note_view(conditions: list[str], boxes: tuple[LabelledBox, ...], pose: Pose) -> None:
    board = boxes[0]
    size = max(board.xyxy[2] - board.xyxy[0], board.xyxy[3] - board.xyxy[1])
    if size < FAR_PX:
        conditions.append("far")
    if size > CLOSE_PX:
        conditions.append("close")
    if board.visible < 0.98:
        conditions.append("partial")
        if "arm" in conditions:
            conditions.append("obstruction")
    cosine = -(pose.rotation[:, 0] @ pose.translation) / np.linalg.norm(pose.translation)
    if cosine < np.cos(np.radians(TILTED_DEG)):
        conditions.append("orientation")

"""Pictures and true depth of a world, through the pinholes of the rig, without a screen."""

from __future__ import annotations

import sys
import threading
from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from contact_sim.errors import RenderError
from contact_sim.scene import SEEN_GROUP, Snapshot
from contact_sim.sensing.gl import open_context
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose

NEAR_M = 0.05
FAR_M = 500.0
SKY_M = 120.0
"""Worlds are smaller; the sky is a box that is drawn at a third of ``FAR_M``, or farther."""
COLOR_CAMERA = "drone/color"
DEPTH_CAMERA = "drone/depth"
_RDF_FROM_GL = np.diag([1.0, -1.0, -1.0])
"""OpenGL's cameras have y up and look along -z."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a perfect camera sees from one place."""

    color: NDArray[np.uint8]  # (H, W, 3)
    """RGB; its levels are roots of light."""
    depth_m: NDArray[np.float32]  # (H, W)
    """Along the axis of the camera; infinite where nothing stands."""
    world_from_camera: Pose
    intrinsics: CameraIntrinsics


class Renderer:
    """Draws one model for the two cameras of a rig; used from the thread that made it, alone.

    Physics may go on in another thread: this keeps a state of its own, filled from snapshots.

    Raises:
        RenderError: no OpenGL draws here without a screen, or an intrinsic has a lens model.
    """

    def __init__(self, model: mujoco.MjModel, rig: RgbdCamera) -> None:
        for name, camera in (("color", rig.color), ("depth", rig.depth)):
            if camera.model != "none":
                raise RenderError(
                    f"the rig's {name} camera has a lens of model {camera.model}: the simulated "
                    "camera is a pinhole, use model none"
                )
        self._rig = rig
        self._model = model
        self._data = mujoco.MjData(model)
        self._lights = {model.light(i).name: i for i in range(model.nlight)}
        model.vis.global_.offwidth = max(rig.color.width, rig.depth.width)
        model.vis.global_.offheight = max(rig.color.height, rig.depth.height)
        # One sample a pixel: of several depths one is kept that lies off the pixel's middle, by
        # 0.4 px; and four samples triple the time. The lens softens edges (color.py).
        model.vis.quality.offsamples = 0
        self._thread = threading.get_ident()
        self._gl = open_context(model.vis.global_.offwidth, model.vis.global_.offheight)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        # zero for far: floats are finest near zero, where a camera's depth is coarsest
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, maxgeom=2 * model.ngeom + 100)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = False
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = 0
        self._options.geomgroup[SEEN_GROUP] = 1
        self._options.sitegroup[:] = 0
        self._eye = mujoco.MjvCamera()
        self._open = True

    def place(self, snapshot: Snapshot) -> None:
        """Put everything where a snapshot has it, and put out the lamps that are out.

        Raises:
            RenderError: the snapshot is of another model, or names a lamp that there is not.
        """
        self._check_thread()
        if snapshot.qpos.shape != (self._model.nq,):
            raise RenderError(
                f"a snapshot of {snapshot.qpos.shape} coordinates is not of this model, which has "
                f"{self._model.nq}"
            )
        unknown = snapshot.lamps_out - self._lights.keys()
        if unknown:
            raise RenderError(
                f"no light {sorted(unknown)[0]!r}; there are: {', '.join(sorted(self._lights))}"
            )
        self._data.qpos[:] = snapshot.qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._options,
            None,
            self._eye,
            mujoco.mjtCatBit.mjCAT_ALL,
            self._scene,
        )
        if snapshot.lamps_out:
            self._put_out(snapshot.lamps_out)

    def _put_out(self, lamps: frozenset[str]) -> None:
        """Neither the lights nor what glows there, the geoms of the same names."""
        lights = {self._lights[name] for name in lamps}
        for light in self._scene.lights[: self._scene.nlight]:
            if light.id in lights and not light.headlight:
                light.diffuse[:] = light.specular[:] = light.ambient[:] = 0.0
        kind = mujoco.mjtObj.mjOBJ_GEOM
        bulbs = {mujoco.mj_name2id(self._model, kind, name) for name in lamps}
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == kind and geom.objid in bulbs:
                geom.emission = 0.0

    def pose_of(self, camera: str) -> Pose:
        """``world_from_camera`` (RDF) of one of the model's cameras, as last placed.

        Raises:
            RenderError: the model has no such camera.
        """
        index = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if index < 0:
            raise RenderError(f"the model has no camera {camera!r}")
        rotation = self._data.cam_xmat[index].reshape(3, 3) @ _RDF_FROM_GL
        return Pose.from_rotation(rotation, self._data.cam_xpos[index].copy())

    def color(self, world_from_camera: Pose | None = None) -> View:
        """What the colour camera sees, from its own place or from another one."""
        return self._view(self._rig.color, world_from_camera or self.pose_of(COLOR_CAMERA))

    def depth(self, world_from_camera: Pose | None = None) -> View:
        """What the left eye of the depth camera sees, from its own place or from another one."""
        return self._view(self._rig.depth, world_from_camera or self.pose_of(DEPTH_CAMERA))

    def close(self) -> None:
        """Give the GL back; also when it was closed before."""
        if self._open:
            self._check_thread()
            self._free()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __del__(self) -> None:
        # What is forgotten would free its textures by their numbers in whichever GL is current:
        # another renderer's.
        if getattr(self, "_open", False) and not sys.is_finalizing():
            self._free()

    def _free(self) -> None:
        self._open = False
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def _view(self, intrinsics: CameraIntrinsics, world_from_camera: Pose) -> View:
        self._check_thread()
        self._aim(intrinsics, world_from_camera)
        shape = intrinsics.height, intrinsics.width
        color = np.empty((*shape, 3), np.uint8)
        nearness = np.empty(shape, np.float32)
        rect = mujoco.MjrRect(0, 0, intrinsics.width, intrinsics.height)
        self._gl.make_current()
        mujoco.mjr_render(rect, self._scene, self._context)
        mujoco.mjr_readPixels(color, nearness, rect, self._context)
        return View(
            np.ascontiguousarray(color[::-1]),
            _depth_m(nearness[::-1]),
            world_from_camera,
            intrinsics,
        )

    def _aim(self, intrinsics: CameraIntrinsics, world_from_camera: Pose) -> None:
        """The frustum of an off-axis pinhole: pixel centres lie on whole numbers."""
        i = intrinsics
        left, right = (-0.5 - i.cx) / i.fx, (i.width - 0.5 - i.cx) / i.fx
        top, bottom = (i.cy + 0.5) / i.fy, -(i.height - 0.5 - i.cy) / i.fy
        rotation = world_from_camera.rotation
        for camera in self._scene.camera:  # one an eye; both the same
            camera.pos[:] = world_from_camera.translation
            camera.forward[:] = rotation[:, 2]
            camera.up[:] = -rotation[:, 1]
            camera.frustum_near, camera.frustum_far = NEAR_M, FAR_M
            camera.frustum_center = NEAR_M * (left + right) / 2
            camera.frustum_width = NEAR_M * (right - left) / 2
            camera.frustum_top, camera.frustum_bottom = NEAR_M * top, NEAR_M * bottom
            camera.orthographic = 0

    def _check_thread(self) -> None:
        if not self._open:
            raise RenderError("the renderer was closed")
        if threading.get_ident() != self._thread:
            raise RenderError(
                "OpenGL belongs to the thread that opened it: use a renderer from the thread that "
                "made it"
            )


def _depth_m(nearness: NDArray[np.float32]) -> NDArray[np.float32]:
    """Depth (H, W) of the reversed depth buffer, which is 1 at NEAR_M and 0 at FAR_M."""
    inverse = nearness * np.float32(1 / NEAR_M - 1 / FAR_M) + np.float32(1 / FAR_M)
    depth = 1 / inverse
    depth[depth > SKY_M] = np.inf
    return np.asarray(depth, dtype=np.float32)

"""The renderer: pixels where the projection says, true depth, lamps, threads, and no OpenGL."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from contact_sim.errors import RenderError
from contact_sim.scene import Snapshot
from contact_sim.scene.shapes import add_shape, panel
from contact_sim.scene.textures import add_material
from contact_sim.sensing import d455
from contact_sim.sensing.renderer import Renderer
from rgbd_wire.geometry import Pose, rotation_from_vector

RIG = d455()
FLU_FROM_RDF = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
EYE = Pose.from_rotation(
    rotation_from_vector(np.array([0.02, -0.03, 0.5])) @ FLU_FROM_RDF, np.array([1.0, -2.0, 1.5])
)
"""A camera in the world, a little askew."""
BALL_M = 0.03
STILL = Snapshot(0, np.zeros(0))


def balls(places):
    """A world of red balls at places (N, 3) in the camera's frame, and a lamp behind it."""
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.1,) * 3, (0.0,) * 3
    spec.worldbody.add_light(
        name="lamp", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=EYE.rotation[:, 2]
    )
    for i, place in enumerate(places):
        spec.worldbody.add_geom(
            name=f"ball_{i}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(BALL_M, 0, 0),
            pos=EYE @ np.asarray(place),
            rgba=(1, 0, 0, 1),
        )
    return spec.compile()


def seen_by(intrinsics):
    """Places (N, 3) in the camera whose pictures are spread and do not touch, and their pixels."""
    u = np.array([0.1, 0.37, 0.63, 0.9]) * intrinsics.width
    v = np.array([0.12, 0.5, 0.88]) * intrinsics.height
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    z = np.linspace(1.0, 2.5, len(uv))
    x = (uv[:, 0] - intrinsics.cx) / intrinsics.fx * z
    y = (uv[:, 1] - intrinsics.cy) / intrinsics.fy * z
    return np.column_stack([x, y, z]), uv


@pytest.mark.parametrize("which", ["color", "depth"])
def test_what_stands_at_a_point_appears_at_its_pixel(which):
    """The middle of a ball's silhouette is its projection, principal point and all, to 0.4 px."""
    intrinsics = getattr(RIG, which)
    places, uv = seen_by(intrinsics)
    with Renderer(balls(places), RIG) as renderer:
        renderer.place(STILL)
        view = getattr(renderer, which)(EYE)
    rows, columns = np.nonzero(np.isfinite(view.depth_m))
    near = np.argmin(np.hypot(columns[:, None] - uv[:, 0], rows[:, None] - uv[:, 1]), axis=1)
    for i, (place, pixel) in enumerate(zip(places, uv, strict=True)):
        mine = near == i
        # a ball's silhouette is an ellipse whose middle lies a little outward of its centre's
        share = BALL_M**2 / place[2] ** 2
        outward = (pixel - (intrinsics.cx, intrinsics.cy)) * share
        middle = np.array([columns[mine].mean(), rows[mine].mean()])
        np.testing.assert_allclose(middle, pixel + outward, atol=0.4)


def test_depth_is_along_the_axis_and_endless_where_nothing_stands():
    """The front of a ball is a radius nearer than its middle, along its own ray."""
    places, uv = seen_by(RIG.depth)
    with Renderer(balls(places), RIG) as renderer:
        renderer.place(STILL)
        view = renderer.depth(EYE)
    for place, (u, v) in zip(places, np.rint(uv).astype(int), strict=True):
        away = np.linalg.norm(place)
        front = place[2] * (1 - BALL_M / away)
        assert view.depth_m[v, u] == pytest.approx(front, abs=2e-3)
    assert np.isinf(view.depth_m).mean() > 0.9


def test_a_texture_stands_upright_and_is_not_mirrored():
    """A sheet with a red, a green, a blue and a white corner shows them where they belong."""
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:32, :32], picture[:32, 32:] = (255, 0, 0), (0, 255, 0)
    picture[32:, :32], picture[32:, 32:] = (0, 0, 255), (255, 255, 255)
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient = (1.0, 1.0, 1.0)
    add_material(spec, "corners", picture)
    # one metre before a camera at the origin that looks along x
    sheet = panel(np.array([1, 0.4, 0.4]), np.array([0, -0.8, 0]), np.array([0, 0, -0.8]), 0.8)
    add_shape(spec, "corners", sheet, "corners")
    with Renderer(spec.compile(), RIG) as renderer:
        renderer.place(STILL)
        color = renderer.color(Pose.from_rotation(FLU_FROM_RDF, np.zeros(3))).color
    step = int(0.2 * RIG.color.fx)
    u, v = round(RIG.color.cx), round(RIG.color.cy)
    corners = [color[v + dv, u + du] > 128 for dv in (-step, step) for du in (-step, step)]
    assert [tuple(c.tolist()) for c in corners] == [
        (True, False, False),
        (False, True, False),
        (False, False, True),
        (True, True, True),
    ]


def test_a_lamp_that_is_out_lights_nothing():
    """The same place is dark, and light again with the next snapshot."""
    model = balls([(0.0, 0.0, 1.0)])
    with Renderer(model, RIG) as renderer:
        brightness = []
        for out in (frozenset(), frozenset({"lamp"}), frozenset()):
            renderer.place(replace(STILL, lamps_out=out))
            brightness.append(int(renderer.color(EYE).color.max()))
    assert brightness[0] == brightness[2]
    assert brightness[1] < 0.5 * brightness[0]


def test_it_sees_from_the_models_own_cameras():
    """A camera of the model is found by its name, and its pose is one of ours: z ahead."""
    spec = mujoco.MjSpec()
    gl = Pose.from_rotation(EYE.rotation @ np.diag([1.0, -1.0, -1.0]), EYE.translation)
    spec.worldbody.add_camera(name="drone/color", pos=gl.translation, quat=gl.q_wxyz)
    with Renderer(spec.compile(), RIG) as renderer:
        renderer.place(STILL)
        found = renderer.pose_of("drone/color")
        np.testing.assert_allclose(found.matrix, EYE.matrix, atol=1e-9)
        np.testing.assert_allclose(renderer.color().world_from_camera.matrix, EYE.matrix, atol=1e-9)
        with pytest.raises(RenderError, match="no camera 'drone/depth'"):
            renderer.depth()


def test_renderers_side_by_side_and_forgotten_ones_do_not_meddle():
    """A second one, made and dropped, leaves the first one's pictures as they were."""
    first = Renderer(balls([(0.0, 0.0, 1.0)]), RIG)
    first.place(STILL)
    before = first.color(EYE)
    other = Renderer(balls([(0.3, 0.0, 1.0)]), RIG)
    other.place(STILL)
    assert (other.color(EYE).color != before.color).any()
    del other
    np.testing.assert_array_equal(first.color(EYE).color, before.color)
    first.close()
    first.close()
    with pytest.raises(RenderError, match="was closed"):
        first.color(EYE)


def test_another_thread_is_refused():
    """OpenGL would draw nothing there, and say nothing."""
    said = []

    def use():
        try:
            renderer.place(STILL)
        except RenderError as error:
            said.append(str(error))

    with Renderer(balls([(0.0, 0.0, 1.0)]), RIG) as renderer:
        thread = threading.Thread(target=use)
        thread.start()
        thread.join()
    assert said
    assert "the thread that made it" in said[0]


@pytest.mark.parametrize(
    ("snapshot", "words"),
    [
        (Snapshot(0, np.zeros(3)), "is not of this model, which has 0"),
        (replace(STILL, lamps_out=frozenset({"moon"})), "no light 'moon'; there are: lamp"),
    ],
)
def test_a_snapshot_of_something_else_is_refused(snapshot, words):
    """The error says what does not fit."""
    with (
        Renderer(balls([(0.0, 0.0, 1.0)]), RIG) as renderer,
        pytest.raises(RenderError, match=words),
    ):
        renderer.place(snapshot)


def test_a_lens_is_refused():
    """The pictures would not be what the intrinsics say."""
    lens = replace(RIG.color, model="brown_conrady", coefficients=(0.1, 0, 0, 0, 0))
    with pytest.raises(RenderError, match="a lens of model brown_conrady"):
        Renderer(balls([]), replace(RIG, color=lens))


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"MUJOCO_GL": "vulkan"}, ["'vulkan' is none of egl, osmesa, glfw", "libegl1"]),
        ({"MUJOCO_GL": "osmesa"}, ["as MUJOCO_GL asks", "osmesa (", "libosmesa6"]),
        ({}, ["without a screen", "egl (", "osmesa (", "libegl-mesa0", "libosmesa6"]),
    ],
)
def test_without_opengl_the_error_says_what_to_install(tmp_path, variables, words):
    """In a process whose libraries cannot draw, each that was tried is named, and the packages."""
    script = (
        "from contact_sim.errors import RenderError\n"
        "from contact_sim.sensing.gl import choose_gl\n"
        "try:\n    choose_gl()\n"
        "except RenderError as error:\n    print(error)\n"
    )
    environment = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"} | variables
    for name in ("libOSMesa.so", "libOSMesa.so.6", "libOSMesa.so.8"):
        (tmp_path / name).write_bytes(b"")  # found first, and no library
    environment["LD_LIBRARY_PATH"] = str(tmp_path)
    environment["__EGL_VENDOR_LIBRARY_FILENAMES"] = str(tmp_path / "none.json")  # no driver
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    for word in words:
        assert word in done.stdout
    assert done.stdout.count("\n") == 1

"""What other packages may rely on: a change of this table is a change of the interface."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys

import pytest

import rgbd_wire

PUBLIC = {
    "camera": "CameraIntrinsics RgbdCamera camera_from_json load_camera",
    "clock": "Clock ManualClock MonotonicClock",
    "color": "decode_color encode_color",
    "depth": "CodedDepth DepthPlan DepthTable coarse_size decode_depth encode_depth lattice_values",
    "envelope": "Kind seal unseal",
    "errors": "CameraFileError DecodeError GeometryError Reject TlsFilesError WireError",
    "frame": "RgbdFrame",
    "frame_codec": "CompressedFrame Encoding FrameStamp PackedFrame compress decompress pack "
    "unpack",
    "geometry": "Pose quaternion_from_rotation quaternion_product rotation_from_quaternion "
    "rotation_from_vector skew slerp vec3 vector_from_rotation",
    "hosts": "resolve",
    "jxl_header": "check_plain_picture",
    "messages": "Ack FrameHeader Intrinsics LevelBox Outcome Result Status TargetPose decode_ack "
    "decode_header decode_result decode_status encode_header pack_covariance pose_numbers pose_of "
    "seal_ack seal_result seal_status unpack_covariance",
    "probe": "Probe decode_probe seal_probe",
    "quaternion": "about_up conjugate from_vector multiplied product rotate rotate_back to_vector",
    "streams": "Stream Urgency drone_of_key worker_key worker_of_key worker_status_key",
    "tls_files": "TlsFiles tls_files",
    "tunnel": "",
}


def test_every_module_is_listed():
    """No module comes or goes unnoticed."""
    assert {m.name for m in pkgutil.iter_modules(rgbd_wire.__path__)} == set(PUBLIC)


@pytest.mark.parametrize("name", PUBLIC)
def test_classes_and_functions(name):
    """A module offers what is listed, each with a docstring, and nothing else."""
    module = importlib.import_module(f"rgbd_wire.{name}")
    own = {
        n: thing
        for n, thing in vars(module).items()
        if not n.startswith("_")
        and (inspect.isclass(thing) or callable(thing))
        and getattr(thing, "__module__", None) == module.__name__
    }
    assert set(own) == set(PUBLIC[name].split())
    assert all(inspect.getdoc(thing) for thing in own.values())


def test_geometry_is_light():
    """Who needs poses alone loads no codec and no message library."""
    code = "import sys, rgbd_wire.camera; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "rgbd_wire.geometry" in loaded
    assert not {"imagecodecs", "msgspec", "cv2", "zenoh", "torch"} & set(loaded)

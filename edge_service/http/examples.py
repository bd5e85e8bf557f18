"""The examples of the OpenAPI description."""

from __future__ import annotations

from typing import Any

from edge_service.http.bodies import ErrorBody

METRICS = """\
# HELP edge_frames_total Frames answered, by outcome.
# TYPE edge_frames_total counter
edge_frames_total{outcome="target"} 1842.0
edge_frames_total{outcome="superseded"} 3.0
"""

CAMERA = """\
{"color": {"width": 640, "height": 480, "fx": 585.0, "fy": 585.0, "cx": 320.0, "cy": 240.0},
 "depth_scale_m": 0.0002}"""

CURL = """\
curl -F color=@color.jpg -F depth=@depth.png -F camera=@camera.json \\
  http://localhost:8080/v1/localize
curl -F color=@color.jpg -F camera=@camera.json -o found.png \\
  'http://localhost:8080/v1/localize?draw=1'"""

LOCALIZE_REQUEST: dict[str, Any] = {
    "required": True,
    "description": f"Example:\n\n```\n{CURL}\n```",
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["color", "camera"],
                "properties": {
                    "color": {
                        "type": "string",
                        "format": "binary",
                        "description": "JPEG, or PNG with 8 bits per sample; "
                        "its size must be that of the camera JSON's color.",
                    },
                    "depth": {
                        "type": "string",
                        "format": "binary",
                        "description": "16-bit grey PNG in units of depth_scale_m, 0: no depth. "
                        "Aligned to the colour picture unless the camera JSON gives depth and "
                        "color_from_depth. Without it the range rests on the circles alone.",
                    },
                    "camera": {
                        "type": "string",
                        "description": "The camera JSON. Required: color and depth_scale_m.",
                        "example": CAMERA,
                    },
                },
            }
        }
    },
}

LOCALIZED: dict[str, Any] = {
    "outcome": "target",
    "reason": "",
    "target": {
        "camera_from_target": {
            "translation_m": [0.341, 0.171, 2.211],
            "q_wxyz": [0.2, 0.33, 0.56, -0.73],
            "matrix": [
                [-0.40, 0.90, -0.17, 0.341],
                [0.31, -0.04, -0.95, 0.171],
                [-0.86, -0.43, -0.26, 2.211],
                [0.0, 0.0, 0.0, 1.0],
            ],
        },
        "distance_m": 2.244,
        "tilt_deg": 25.6,
        "sigmas": {
            "right_down_forward_mm": [1.8, 1.4, 5.2],
            "range_mm": 5.3,
            "across_mm": 1.2,
            "normal_deg": 0.4,
            "roll_deg": 0.5,
        },
        "covariance_frame": "camera",
        "covariance": [[1e-6 if r == c else 0.0 for c in range(6)] for r in range(6)],
        "method": "fused",
        "roll_source": "edges",
        "ambiguous": False,
        "alternative": {
            "translation_m": [0.341, 0.171, 2.211],
            "q_wxyz": [0.28, 0.42, 0.63, -0.59],
            "matrix": [
                [-0.49, 0.86, -0.17, 0.341],
                [0.2, -0.08, -0.98, 0.171],
                [-0.85, -0.51, -0.13, 2.211],
                [0.0, 0.0, 0.0, 1.0],
            ],
        },
        "score": 0.93,
        "boxes": [
            {"level": "T_good", "x0": 353.4, "y0": 232.6, "x1": 469.3, "y1": 335.2, "score": 0.94}
        ],
        "evidence": {
            "range_ellipse_m": 2.246,
            "range_ellipse_sigma_m": 0.0066,
            "range_plane_m": 2.243,
            "range_plane_sigma_m": 0.0094,
            "ranges_apart_sigmas": -0.26,
            "ellipse_rms_px": 0.11,
            "ellipse_points": 121,
            "ellipse_points_measured": 128,
            "circles": [
                {"diameter_m": 0.3, "measured": 64, "used": 60, "rms_px": 0.12},
                {"diameter_m": 0.14, "measured": 64, "used": 61, "rms_px": 0.1},
            ],
            "picture_points": 0,
            "picture_rms_levels": None,
            "plane_inliers": 2400,
            "plane_rms_m": 0.004,
            "depth_contradicts": False,
        },
    },
    "timings_ms": {"detect": 13.5, "nest": 0.4, "localise": 3.1},
    "model": "5f2a...",
}

NOTHING: dict[str, Any] = {
    "outcome": "nothing_found",
    "reason": "no box",
    "target": None,
    "timings_ms": {"detect": 13.4},
    "model": "5f2a...",
}

LOCALIZE_EXAMPLES = {"a target": {"value": LOCALIZED}, "no target": {"value": NOTHING}}


def _error(description: str, field: str | None, detail: str) -> dict[str, Any]:
    example = {"field": field, "detail": detail}
    return {
        "model": ErrorBody,
        "description": description,
        "content": {"application/json": {"example": example}},
    }


LOCALIZE_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"description": "What was found, or why nothing was."},
    408: _error("The upload took too long.", None, "the upload took too long"),
    413: _error("The upload is too large.", None, "the upload is over 24 MB"),
    422: _error(
        "A field cannot be used.",
        "depth",
        "depth: the picture is 320x240, the camera JSON says 640x480",
    ),
    500: _error(
        "A fault of the service's own.", None, "a fault of the service's own; its log says more"
    ),
    503: _error(
        "The model is not warm yet, or too many pictures wait; see Retry-After.",
        None,
        "too many pictures wait already",
    ),
}

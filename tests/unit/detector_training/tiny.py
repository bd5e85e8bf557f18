"""A data set of four small pictures with a bullseye each."""

from __future__ import annotations

import json

import cv2
import numpy as np

from target_pose.target import Level


def write_tiny(folder):
    """Write it into a folder, and return the folder."""
    (folder / "images").mkdir()
    rows = []
    for k in range(4):
        picture = np.full((192, 256, 3), 90 + 10 * k, np.uint8)
        u, v, half = 70 + 30 * k, 90 + 5 * k, 40
        cv2.rectangle(picture, (u - half, v - half), (u + half, v + half), (220,) * 3, -1)
        for radius, gray in ((30, 20), (14, 220), (6, 20)):
            cv2.circle(picture, (u, v), radius, (gray,) * 3, -1)
        cv2.imwrite(str(folder / f"images/{k:06d}.jpg"), picture)
        sides = dict(zip(Level, (40, 30, 14), strict=True))
        boxes = [
            {"level": level, "xyxy": [u - s, v - s, u + s, v + s], "visible": 1.0}
            for level, s in sides.items()
        ]
        rows.append(
            {
                "image": f"images/{k:06d}.jpg",
                "width": 256,
                "height": 192,
                "kind": "scene",
                "conditions": ["far"],
                "boxes": boxes,
            }
        )
    (folder / "labels.jsonl").write_text("".join(json.dumps(r) + "\n" for r in rows))
    return folder

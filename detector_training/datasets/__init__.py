"""Labelled pictures on disk: the generator's own lines, labelme, YOLO and COCO."""

"""The files themselves, read back by others: PDF by PDFium and OpenCV, SVG by an XML parser."""

import hashlib
import re
import warnings
import xml.etree.ElementTree as ET

import cv2
import numpy as np
import pypdfium2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector_training.errors import TargetPrintError
from detector_training.targets.layout import Paper, lay_out
from detector_training.targets.pdf import pdf_bytes
from detector_training.targets.shapes import Page, Text
from detector_training.targets.svg import svg_text
from detector_training.targets.tiles import OVERLAP_MM
from target_pose.target import load_target

DPI = 300
PX_PER_MM = DPI / 25.4
DIGEST = "0123456789ab"


def render(data, dpi=DPI):
    """Pages of a PDF as gray pictures."""
    document = pypdfium2.PdfDocument(data)
    try:
        return [p.render(scale=dpi / 72, grayscale=True).to_numpy().squeeze() for p in document]
    finally:
        document.close()


def discs_of(picture, least_mm):
    """Diameter and centre [mm] of every disc, dark or light, by its gray area and first moments."""
    dark = (picture < 128).astype(np.uint8)
    contours, _ = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    found = []
    for contour in contours:
        x, y, w, h = cv2.boundingRect(contour)
        fill = cv2.contourArea(contour) / (w * h)
        if min(w, h) < least_mm * PX_PER_MM or abs(w - h) > 2 or abs(fill - np.pi / 4) > 0.02:
            continue
        x0, y0, x1, y1 = x - 4, y - 4, x + w + 4, y + h + 4
        inside = np.zeros((y1 - y0, x1 - x0), np.uint8)
        cv2.drawContours(inside, [contour], -1, 1, cv2.FILLED, offset=(-x0, -y0))
        band = np.ones((9, 9), np.uint8)
        core, near = cv2.erode(inside, band) > 0, cv2.dilate(inside, band) > 0
        ink = 1 - picture[y0:y1, x0:x1] / 255
        is_dark = dark[y + h // 2, x + 8] > 0
        # partly covered pixels count by their gray, and what else lies inside counts in full
        share = np.where(core, 1.0, np.where(near, ink if is_dark else 1 - ink, 0.0))
        rows, columns = np.mgrid[y0:y1, x0:x1]
        centre = [(share * at).sum() / share.sum() + 0.5 for at in (columns, rows)]
        found.append((2 * np.sqrt(share.sum() / np.pi), *centre))
    return np.array(sorted(found, reverse=True)) / PX_PER_MM


@pytest.mark.parametrize(
    ("name", "paper"), [("bullseye-200", Paper.A4), ("bullseye-400", Paper.FIT)]
)
def test_the_pdf_measures_right(name, paper):
    """At 300 dpi diameters are right and circles concentric to 0.1 mm, and the ruler is 100 mm."""
    target = load_target(name)
    pages = lay_out(target, DIGEST, paper, 5.0)
    (picture,) = render(pdf_bytes(pages, name))
    size = np.array(picture.shape[::-1]) / PX_PER_MM
    assert size == pytest.approx([pages[0].width_mm, pages[0].height_mm], abs=0.1)
    discs = discs_of(picture, 20)
    sizes = [1000 * d.diameter_m for d in target.discs]
    assert discs[:, 0] == pytest.approx(sizes, abs=0.1)
    assert np.ptp(discs[:, 1:], axis=0).max() < 0.1
    centre = discs[0, 1:]
    outline = centre[0] - 1000 * target.board_side_m / 2
    row = picture[round((centre[1]) * PX_PER_MM)].astype(float)
    left = row[: round((outline + 3) * PX_PER_MM)]
    at = ((255 - left) * (np.arange(len(left)) + 0.5)).sum() / (255 - left).sum() / PX_PER_MM
    assert at == pytest.approx(outline, abs=0.1)
    assert ruler_mm(picture, centre[1] + 500 * target.board_side_m) == pytest.approx(100, abs=0.1)


def ruler_mm(picture, below_mm):
    """Length of the longest horizontal stroke below the board, between its outer ticks."""
    part = picture[round((below_mm + 15) * PX_PER_MM) :]
    ink = part < 160
    row = int(np.argmax(ink.sum(axis=1)))
    ticks = 255.0 - part[row + round(1 * PX_PER_MM)]
    columns = np.flatnonzero(ticks > 60)
    edges = [columns[0], columns[-1]]
    near = [np.arange(e - 2, e + 3) for e in edges]
    first, last = ((ticks[n] * n).sum() / ticks[n].sum() for n in near)
    return (last - first) / PX_PER_MM


def test_tiles_put_together_are_the_whole():
    """Pages cut and laid as their marks say show what one large page shows, but for the marks."""
    target, dpi, margin = load_target(), 75, 5.0
    scale = dpi / 25.4
    (whole,) = render(pdf_bytes(lay_out(target, DIGEST, Paper.FIT, 0.0), "x"), dpi)
    pages = lay_out(target, DIGEST, Paper.A4, margin, tiles=True)
    assert len(pages) == 6
    pictures = render(pdf_bytes(pages, "x"), dpi)
    made = np.full((2400, 2400), 255, np.uint8)
    for page, picture in zip(pages, pictures, strict=True):
        label = next(m.text for m in page.marks if isinstance(m, Text))
        row, column = map(int, re.search(r"row (\d), column (\d)", label).groups())
        window = page.window
        x = (column - 1) * (window.width_mm - OVERLAP_MM)
        y = (row - 1) * (window.height_mm - OVERLAP_MM)
        size = (round(window.width_mm * scale), round(window.height_mm * scale))
        # to whole pixels of the large page by a shift of its own, as one does by hand
        shift = np.float32([[1, 0, -margin * scale], [0, 1, -margin * scale]])
        part = cv2.warpAffine(picture, shift, size, flags=cv2.INTER_LINEAR, borderValue=255)
        left, top = round(x * scale), round(y * scale)
        made[top : top + size[1], left : left + size[0]] = part
    made = made[: whole.shape[0], : whole.shape[1]]
    # what is left is thin: half pixels at edges, and the dashes at the seams
    wrong = (np.abs(made.astype(int) - whole) > 100).astype(np.uint8)
    assert cv2.erode(wrong, np.ones((4, 4), np.uint8)).sum() == 0
    assert wrong.mean() < 0.01


def test_labels_of_tiles():
    """Pages are named by row and column, each once."""
    pages = lay_out(load_target(), DIGEST, Paper.A4, 5.0, tiles=True)
    labels = [next(m.text for m in p.marks if isinstance(m, Text)) for p in pages]
    assert labels[1] == "bullseye-400: row 1, column 2 of 2 x 3"
    assert len(set(labels)) == len(labels)


def test_the_svg_measures_right():
    """One user unit is one millimetre, and circles and board have the file's sizes."""
    target = load_target("bullseye-200")
    (page,) = lay_out(target, DIGEST, Paper.A4, 5.0)
    root = ET.fromstring(svg_text(page, "x"))
    assert (root.get("width"), root.get("height")) == ("210mm", "297mm")
    assert root.get("viewBox") == "0 0 210 297"
    space = "{http://www.w3.org/2000/svg}"
    circles = root.findall(f".//{space}circle")
    assert [2 * float(c.get("r")) for c in circles] == [150, 70, 30]
    (board,) = root.findall(f".//{space}rect")
    centre = float(board.get("x")) + 100, float(board.get("y")) + 100
    assert {(float(c.get("cx")), float(c.get("cy"))) for c in circles} == {centre}
    told = " ".join(t.text for t in root.findall(f".//{space}text"))
    for word in ("bullseye-200", DIGEST, "T_better 150 mm", "Print at 100 %", "matte", "UP"):
        assert word in told


def test_the_pdf_says_what_it_is():
    """Name, hash and advice can be read out of the PDF as text."""
    data = pdf_bytes(lay_out(load_target(), DIGEST, Paper.FIT, 5.0), "bullseye-400")
    document = pypdfium2.PdfDocument(data)
    text = document[0].get_textpage()
    told = text.get_text_range()
    for word in ("bullseye-400", DIGEST, "T_best 140 mm", "Print at 100 %"):
        assert word in told
    text.close()
    document.close()


def test_bytes_are_the_same_every_time(monkeypatch):
    """No date, no random name, no setting of the user's: a print can be compared by its hash."""
    import matplotlib

    pages = lay_out(load_target(), DIGEST, Paper.A4, 5.0, tiles=True)
    first = pdf_bytes(pages, "x")
    with matplotlib.rc_context({"font.size": 30, "pdf.compression": 0, "lines.linewidth": 9}):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", "12345")
        second = pdf_bytes(pages, "x")
    assert hashlib.sha256(first).digest() == hashlib.sha256(second).digest()
    assert b"CreationDate" not in first
    assert svg_text(pages[0], "x") == svg_text(pages[0], "x")


@given(st.text(st.characters(exclude_categories=["Cs", "Cc", "Cn"]), max_size=64))
def test_any_name_makes_an_svg_that_parses(name):
    """Markup in a name stays text."""
    page = Page(100, 100, (Text(1, 1, name, 3.0, "#000000"),))
    told = ET.fromstring(svg_text(page, name)).find(".//{http://www.w3.org/2000/svg}text")
    assert (told.text or "") == name


def test_a_name_that_the_font_lacks_is_no_warning():
    """A target may be called $標的$: boxes in the PDF, no warning, no formula."""
    page = Page(100, 100, (Text(1, 9, "$標的$_{x", 3.0, "#000000"),))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pdf_bytes([page], "標的").startswith(b"%PDF")


def test_a_page_that_pdf_cannot_hold_is_told():
    """Over 5.08 m PDF has no pages."""
    with pytest.raises(TargetPrintError, match="PDF ends at 5080 mm"):
        pdf_bytes([Page(6000, 100, ())], "x")

"""Make the chessboards to print, with instructions for filming them: hypose/assets/board-a4.pdf and board-a3.pdf.

python -m scripts.bake_board
"""

from __future__ import annotations

from pathlib import Path

_PAPERS = {"a4": (297, 210, 30), "a3": (420, 297, 42)}
"""Width and height of a sheet, and side of a square, mm."""
_COLUMNS, _ROWS = 9, 6
_POINTS = 72 / 25.4
"""Points per millimetre."""
_HOW = (
    "1. Print page 1 in its actual size (100 %), on the largest paper you have. Glue it to something flat and stiff.",
    "2. Measure the side of a square with a ruler: hypose asks for it. It should be {side} mm.",
    "3. Leave the cameras where they are, from the board to the last video: do not touch them or their zoom.",
    "4. Start all cameras. Carry the board slowly through the place where the person moves, for about a minute:",
    "    turned and tilted to all sides, near and far, high and low, and still for a moment in many places.",
    "    Two cameras at least should see it at a time, and each camera in all corners of its picture.",
    "5. At the end lay it flat on the floor and leave it there for two seconds: that is the floor, z = 0.",
    "6. Copy the clips, one per camera, into the folder with your videos, for example as board/cam1.mp4.",
    "7. In Set up, choose 'Look for clips of the board', then 'Calibrate'.",
)


def draw_board(paper: str) -> bytes:
    """Draw the PDF with the chessboard for a paper (a4 or a3) and the instructions for filming it."""
    width, height, side = _PAPERS[paper]
    left, low = (width - _COLUMNS * side) / 2, (height - _ROWS * side) / 2
    squares = [
        f"{left + side * x} {low + side * y} {side} {side} re f"
        for y in range(_ROWS)
        for x in range(_COLUMNS)
        if (x + y) % 2 == 0
    ]
    caption = f"hypose: {_COLUMNS - 1} x {_ROWS - 1} inner corners, squares of {side} mm when printed in actual size"
    first = [f"{_POINTS} 0 0 {_POINTS} 0 0 cm", *squares, _pdf_text(left, 4, 3, caption)]
    lines = [_pdf_text(20, height - 40 - 11 * k, 4.5, line.format(side=side)) for k, line in enumerate(_HOW)]
    second = [f"{_POINTS} 0 0 {_POINTS} 0 0 cm", _pdf_text(20, height - 24, 8, "How to film the board"), *lines]
    return _pdf([first, second], width * _POINTS, height * _POINTS)


def _pdf_text(x: float, y: float, size: float, words: str) -> str:
    """Return the PDF operators of a line of text.

    x, y: left end of the base line, mm from the lower left corner of the page.
    size: of the letters, mm.
    """
    escaped = words.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    return f"BT /F {size} Tf {x} {y} Td ({escaped}) Tj ET"


def _pdf(pages: list[list[str]], width: float, height: float) -> bytes:
    """Build a PDF file.

    pages: lines of operators of each page.
    width, height: of every page, points.
    Source: ISO 32000-1, 7.5.
    """
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        "<< /Type /Catalog /Pages 2 0 R >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    for k, operators in enumerate(pages):
        content = "\n".join(operators)
        box = f"/MediaBox [0 0 {width:.2f} {height:.2f}] /Resources << /Font << /F 3 0 R >> >>"
        objects += [
            f"<< /Type /Page /Parent 2 0 R {box} /Contents {5 + 2 * k} 0 R >>",
            f"<< /Length {len(content)} >>\nstream\n{content}\nendstream",
        ]
    out, places = "%PDF-1.4\n", list[int]()
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += f"{number} 0 obj\n{body}\nendobj\n"
    table = "".join(f"{at:010d} 00000 n \n" for at in places)
    count = len(objects) + 1
    end = f"trailer\n<< /Size {count} /Root 1 0 R >>\nstartxref\n{len(out)}\n%%EOF\n"
    return (out + f"xref\n0 {count}\n0000000000 65535 f \n{table}" + end).encode("ascii")


if __name__ == "__main__":
    for name in _PAPERS:
        (Path(__file__).parents[1] / "hypose" / "assets" / f"board-{name}.pdf").write_bytes(draw_board(name))

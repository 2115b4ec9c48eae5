"""Pictures of scenes and the sheets that hold them."""

import numpy as np
from PIL import Image

from smp_gym.inspection.sheets import draw_sheet, pictures
from smp_gym.suites import Cell


def test_each_seed_has_a_picture_of_its_own_that_comes_again():
    first, second = pictures(Cell("Placement", "easy"), range(3, 5))
    assert first.shape == second.shape == (300, 400, 3)
    assert np.abs(first.astype(float) - second).mean() > 2.0
    (again,) = pictures(Cell("Placement", "easy"), range(4, 5))
    np.testing.assert_array_equal(again, second)


def test_a_sheet_has_four_columns_in_the_order_of_the_seeds(tmp_path):
    colours = [np.full((300, 400, 3), shade, np.uint8) for shade in (0, 60, 120, 180, 30)]
    draw_sheet(tmp_path / "sheet.png", "title", range(5), colours)
    with Image.open(tmp_path / "sheet.png") as image:
        sheet = np.asarray(image.convert("L"), float)
    height, width = sheet.shape
    row = sheet[int(0.35 * height), [int((2 * k + 1) * width / 8) for k in range(4)]]
    np.testing.assert_array_equal(row, [0, 60, 120, 180])
    row = sheet[int(0.75 * height), [int((2 * k + 1) * width / 8) for k in range(4)]]
    np.testing.assert_array_equal(row, [30, 255, 255, 255])

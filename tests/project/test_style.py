import numpy as np
import pandas as pd
from matplotlib.colors import to_rgb

from kilnflight.project import style


def lightness(colour):
    return float(np.dot(to_rgb(colour), [0.2126, 0.7152, 0.0722]))


def test_lines_differ_in_grey_or_in_dashes():
    """Neighbours in the cycle stay apart without colour: by lightness or by line style."""
    for one, two in zip(style.COLOURS, style.COLOURS[1:], strict=False):
        assert one != two
        assert abs(lightness(one) - lightness(two)) > 0.05
    assert len(set(map(str, style.LINES))) == len(style.LINES) == len(style.COLOURS)


def test_boxes_are_drawn_where_the_summary_says():
    _, ((axes,),) = style.canvas()
    row = {"whisker_low": -3.0, "q25": -1.0, "median": 0.5, "q75": 1.0, "whisker_high": 4.0}
    style.draw_boxes(axes, pd.DataFrame([row, row]))
    heights = {tuple(line.get_ydata()) for line in axes.lines}
    assert {(-1.0, -3.0), (1.0, 4.0), (0.5, 0.5)} <= heights
    assert len(axes.patches) == 2


def test_a_frame_is_drawn_in_its_pixels_and_circles_in_their_size():
    gray = np.zeros((7, 9), np.uint16)
    gray[:2, :2] = 400
    _, ((axes,),) = style.canvas()
    style.draw_frame(axes, gray)
    image = axes.images[0]
    assert image.get_array().shape == (3, 4)
    assert image.get_array()[0, 0] == 20.0
    assert tuple(image.get_extent()) == (-0.5, 7.5, 5.5, -0.5)
    style.draw_circles(axes, np.array([[2.0, 3.0, 1.5]]), "black")
    (path,) = axes.collections[0].get_paths()
    assert path.get_extents().get_points().tolist() == [[1.5, 0.5], [4.5, 3.5]]
    style.plt.close("all")


def test_what_the_data_are_stands_below_the_legend():
    picture, ((axes,),) = style.canvas()
    axes.plot([0, 1], label="a line")
    legend = picture.legend(loc="outside lower right")
    word = style.mark(picture, "simulated").texts[-1]
    picture.draw_without_rendering()
    assert word.get_text() == "simulated"
    assert word.get_window_extent().y1 <= legend.get_window_extent().y0 + 0.5
    assert axes.get_tightbbox().y0 >= legend.get_window_extent().y1 - 0.5

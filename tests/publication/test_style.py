import numpy as np

from kilnflight.publication import style


def test_a_frame_is_drawn_in_its_pixels_and_circles_in_their_size(axes):
    style.draw_frame(axes, np.zeros((7, 9), np.uint16))
    assert tuple(axes.images[0].get_extent()) == (-0.5, 7.5, 5.5, -0.5)
    style.draw_circles(axes, np.array([[2.0, 3.0, 1.5]]), "black")
    (path,) = axes.collections[0].get_paths()
    assert path.get_extents().get_points().tolist() == [[1.5, 0.5], [4.5, 3.5]]


def test_what_the_data_are_stands_below_the_legend():
    picture, ((axes,),) = style.canvas()
    axes.plot([0, 1], label="a line")
    legend = picture.legend(loc="outside lower right")
    word = style.mark(picture, "simulated").texts[-1]
    picture.draw_without_rendering()
    assert word.get_text() == "simulated"
    assert word.get_window_extent().y1 <= legend.get_window_extent().y0 + 0.5
    assert axes.get_tightbbox().y0 >= legend.get_window_extent().y1 - 0.5

"""Labelled frames written out as MATLAB users leave them: twelve layouts.

`LAYOUTS` maps a name to a function of a folder and of recordings by subset. It writes
their frames and returns the answers to the questions of the draft: what stands in the
draft, and what has to stand there.
"""

import cv2
import h5py
import numpy as np
import scipy.io
import tifffile
from PIL import Image

MASKS = {"flame": 1, "burning_air": 2, "nonburning_air": 3, "burning_wall": 4}
FIVE = [0, 60, 120, 180, 240]  # a class in steps that an eye can tell


def frames(subsets):
    """Yield subset, number from 1 and frame of all recordings."""
    for name, recording in subsets.items():
        for t in range(len(recording)):
            yield name, t + 1, recording.frame(t)


def grid(frame, nothing=np.nan):
    """Return x, y, z (rows, cols, 3) in mm; ``nothing`` where there is no point."""
    image = np.full((*frame.gray.shape, 3), nothing, np.float32)
    image[tuple(frame.pixels.T)] = frame.xyz
    return image


def points(frame):
    """Return row, col, x, y, z (n, 5)."""
    return np.column_stack([frame.pixels, frame.xyz.astype(np.float64)])


def labelled(frame):
    """Return row, col, class (n, 3) of the pixels that are not wall."""
    row, col = np.nonzero(frame.labels)
    return np.column_stack([row, col, frame.labels[row, col]])


def picture(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def text(path, numbers, separator=" ", header=""):
    path.parent.mkdir(parents=True, exist_ok=True)
    form = ["%.9g"] * numbers.shape[1]
    np.savetxt(path, numbers, form, separator, header=header, comments="")


def folders_with_mat(folder, subsets):
    """One folder a subset; PNG, MAT v5 in metres, label pictures."""
    for name, k, frame in frames(subsets):
        picture(folder / name / f"gray_{k:02d}.png", frame.gray)
        picture(folder / name / f"truth_{k:02d}.png", frame.labels)
        scipy.io.savemat(
            folder / name / f"xyz_{k:02d}.mat", {"XYZ": grid(frame) / 1000}
        )


def one_folder_with_hdf5(folder, subsets):
    """One folder for all; TIFF, MAT v7.3, labels in steps of 60."""
    for name, k, frame in frames(subsets):
        tifffile.imwrite(folder / f"{name}_img_{k:03d}.tif", frame.gray)
        picture(folder / f"{name}_label_{k:03d}.png", np.uint8(FIVE)[frame.labels])
        with h5py.File(folder / f"{name}_cloud_{k:03d}.mat", "w") as file:
            file["points"] = grid(frame).T  # MATLAB stores the last axis first


def tables_with_names(folder, subsets):
    """A folder a kind; points and labelled pixels in CSV with a header."""
    for name, k, frame in frames(subsets):
        picture(folder / "images" / f"{name}_{k:04d}.png", frame.gray)
        path = folder / "clouds" / f"{name}_{k:04d}.csv"
        text(path, points(frame), ",", "row,col,x,y,z")
    for name, recording in subsets.items():
        every = {
            k: labelled(recording.frame(k - 1)) for k in range(1, len(recording) + 1)
        }
        rows = np.concatenate(
            [
                np.column_stack([np.full(len(each), k), each])
                for k, each in every.items()
            ]
        )
        text(folder / "labels" / f"{name}.csv", rows, ",", "frame,row,col,class")


def lines_of_pixels(folder, subsets):
    """Text with x y z of every pixel, row by row; 0 where there is no depth."""
    for name, k, frame in frames(subsets):
        picture(folder / name / "picture" / f"{k}.png", frame.gray)
        text(folder / name / "xyz" / f"{k}.txt", grid(frame, 0.0).reshape(-1, 3))
        (folder / name / "labels").mkdir(exist_ok=True)
        path = folder / name / "labels" / f"{k}.mat"
        scipy.io.savemat(path, {"L": frame.labels})


def lines_down_the_columns(folder, subsets):
    """The same column by column, in metres, y down, NaN without depth."""
    for name, k, frame in frames(subsets):
        picture(folder / name / "picture" / f"{k}.png", frame.gray)
        picture(folder / name / "labels" / f"{k}.png", frame.labels)
        turned = np.swapaxes(grid(frame), 0, 1) * [0.001, -0.001, 0.001]
        text(folder / name / "xyz" / f"{k}.txt", turned.reshape(-1, 3), "\t")


def points_col_row(folder, subsets):
    """Points col row x y z without names, counted from 1; labels likewise."""
    for name, k, frame in frames(subsets):
        picture(folder / name / f"image{k}.png", frame.gray)
        turned = points(frame)[:, [1, 0, 2, 3, 4]] + [1, 1, 0, 0, 0]
        text(folder / name / f"points{k}.txt", turned)
        rows = labelled(frame)[:, [1, 0, 2]] + [1, 1, 0]
        text(folder / name / f"marks{k}.txt", np.insert(rows, 0, k, axis=1))


def clouds_with_indices(folder, subsets):
    """MAT with x y z, and the numbers of the pixels as MATLAB's find gives them."""
    for name, k, frame in frames(subsets):
        place = folder / name
        picture(place / "gray" / f"{name}_gray_{k:02d}.png", frame.gray)
        picture(place / "labels" / f"{name}_{k:02d}.png", frame.labels)
        picture(folder / "preview" / f"{name}.jpg", np.uint8(frame.gray[::2, ::2] >> 8))
        row, col = frame.pixels.T
        number = col * frame.gray.shape[0] + row + 1
        (place / "points").mkdir(exist_ok=True)
        content = {"XYZ": frame.xyz, "idx": number[:, None], "sz": frame.gray.shape}
        scipy.io.savemat(place / "points" / f"{name}_{k:02d}.mat", content)


def clouds_without_pixels(folder, subsets):
    """Points x y z alone."""
    for name, k, frame in frames(subsets):
        picture(folder / f"{name}_gray" / f"{k:02d}.png", frame.gray)
        picture(folder / f"{name}_truth" / f"{k:02d}.png", frame.labels)
        text(folder / f"{name}_xyz" / f"{k:02d}.csv", frame.xyz, ",", "x,y,z")


def subsets_by_word(folder, subsets):
    """Subsets without a number; x, y, z one by one, z below 0; labels by frame."""
    for name, k, frame in frames(subsets):
        picture(folder / name / "cam" / f"{k:02d}.tiff", frame.gray)
        (folder / name / "depth").mkdir(exist_ok=True)
        x, y, z = np.moveaxis(grid(frame), 2, 0)
        content = {"X": x, "Y": y, "Z": -z}
        scipy.io.savemat(folder / name / "depth" / f"{k:02d}.mat", content)
        text(folder / name / "marks" / f"{k:02d}.txt", labelled(frame), "\t")


def semicolons_and_palettes(folder, subsets):
    """Two numbers in a folder's name; col row with units, decimal comma; colours."""
    for k, (name, recording) in enumerate(subsets.items()):
        place = folder / f"{name}_2021050{k}_4.5bar" / "gt"
        place.mkdir(parents=True)
        for _, number, frame in frames({name: recording}):
            stem = f"{name}_{number:05d}"
            picture(place.with_name("gray") / f"{stem}_gray.tif", frame.gray)
            turned = points(frame)[:, [1, 0, 2, 3, 4]] + [1, 1, 0, 0, 0]
            turned[:, 3] *= -1
            path = place.with_name("xyz") / f"{stem}_xyz.csv"
            text(path, turned, ";", "u;v;X [mm];Y [mm];Z [mm]")
            path.write_text(path.read_text().replace(".", ","))
            image = Image.fromarray(frame.labels)
            image.putpalette([0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9])
            image.save(place / f"{stem}_gt.png")
            overlay = np.dstack([frame.gray[::2, ::2] >> 8] * 3).astype(np.uint8)
            picture(place / f"{stem}_overlay.png", overlay * np.uint8([1, 1, 0]))


def stacks_with_a_table(folder, subsets):
    """One MAT v7.3 a subset with all frames; labelled pixels of all in CSV."""
    (folder / "data").mkdir()
    for name, recording in subsets.items():
        held = [frame for _, _, frame in frames({name: recording})]
        with h5py.File(folder / "data" / f"2021_{name}_mixed.mat", "w") as file:
            file["gray"] = np.stack([frame.gray.T for frame in held])
            file["xyz"] = np.stack([grid(frame, 0.0).T / 1000 for frame in held])
            file["frameNo"] = 79.0 + np.arange(len(held))[:, None]
            file["fuel"] = np.uint16([[112], [97], [112], [101], [114]])
        rows = [
            np.column_stack(
                [np.full(len(marks), 79 + k), marks[:, 2], marks[:, :2] + [1, 1]]
            )
            for k, marks in enumerate(map(labelled, held))
        ]
        path = folder / "labels" / f"{name}_pixels.csv"
        text(path, np.concatenate(rows), ",", "frame,class,row,col")


def folders_of_frames(folder, subsets):
    """A folder a frame; MAT with a struct, a mask of each class."""
    for name, k, frame in frames(subsets):
        place = folder / f"Exp_{name}" / f"frame_{k:05d}"
        for word, kind in MASKS.items():
            picture(place / f"mask_{word}.png", np.uint8(255 * (frame.labels == kind)))
        picture(place / "grey.png", frame.gray)
        x, y, z = np.moveaxis(grid(frame), 2, 0)
        scipy.io.savemat(place / "data.mat", {"Data": {"X": x, "Y": y, "Z": z}})
    picture(folder / "roi_mask.png", np.uint8(frame.gray > 3000))


LAYOUTS = {
    each.__name__: each
    for each in (
        folders_with_mat,
        one_folder_with_hdf5,
        tables_with_names,
        lines_of_pixels,
        lines_down_the_columns,
        points_col_row,
        clouds_with_indices,
        clouds_without_pixels,
        subsets_by_word,
        semicolons_and_palettes,
        stacks_with_a_table,
        folders_of_frames,
    )
}

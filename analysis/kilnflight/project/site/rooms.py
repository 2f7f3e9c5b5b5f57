"""The rooms of the package and their imports, read from the code."""

from __future__ import annotations

import ast
from pathlib import Path

import grimp
import networkx as nx
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.project import figures
from kilnflight.project.style import PAGE_MM, canvas, style


def imports(package: Path) -> nx.DiGraph:
    """Return the rooms of a package and their imports.

    Rooms are modules or folders at its top.

    Each room has a ``purpose``, the first line of its docstring.
    """
    modules, rooms = grimp.build_graph(package.name, cache_dir=None), nx.DiGraph()
    for module in sorted(modules.find_children(package.name)):
        file = package / f"{module.rpartition('.')[2]}.py"
        if not file.is_file():
            modules.squash_module(module)
            file = file.with_suffix("") / "__init__.py"
        purpose = (ast.get_docstring(ast.parse(file.read_text())) or "").partition("\n")[0]
        rooms.add_node(module.rpartition(".")[2], purpose=purpose)
    for room in rooms:
        imported = modules.find_modules_directly_imported_by(f"{package.name}.{room}")
        others = {name.rpartition(".")[2] for name in imported} & set(rooms) - {room}
        rooms.add_edges_from((room, other) for other in sorted(others))
    return rooms


def draw_rooms(rooms: nx.DiGraph) -> Figure:
    """Draw rooms in layers, each above what it imports; implied imports are left out."""
    layers = dict(enumerate(nx.topological_generations(rooms.reverse())))
    places = nx.multipartite_layout(rooms, subset_key=layers, align="horizontal")
    figure, ((axes,),) = canvas(width_mm=PAGE_MM, height_mm=15.0 * len(layers))
    box = {"boxstyle": "round", "facecolor": "white", "edgecolor": "0.4", "lw": 0.6}
    with style():
        drawn = nx.transitive_reduction(rooms)
        nx.draw_networkx_edges(drawn, places, ax=axes, arrows=False, edge_color="0.6", width=0.6)
        nx.draw_networkx_labels(rooms, places, ax=axes, font_size=7.5, bbox=box)
    axes.axis("off")
    return figure


def rooms_page(rooms: nx.DiGraph) -> str:
    rows = [(room, rooms.nodes[room]["purpose"], ", ".join(sorted(rooms[room]))) for room in rooms]
    return (
        "# The rooms of the package\n\n![Rooms and their imports](rooms.svg)\n\n"
        "A room imports from layers below only. Imports that follow from others are not drawn.\n\n"
        + figures.markdown(pd.DataFrame(rows, columns=["room", "what it is for", "imports"]))
    )

"""Problem files from others' files: maps, layouts, scenarios and shops.

Each importer writes a map and a ``problem.yaml`` into a folder and returns an :class:`Imported`
that tells what it had to assume; the file is then yours to edit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from up_samp.fleet.importers.common import Imported, Options
from up_samp.fleet.importers.grids import import_league, import_movingai
from up_samp.fleet.importers.layouts import import_lif, import_rmf
from up_samp.fleet.importers.outlines import import_dxf, import_svg, map_from_polygons
from up_samp.fleet.importers.shops import import_fjs, import_jsplib
from up_samp.model import UnsupportedError

IMPORTERS: Mapping[str, Callable[[Path, Path, Options], Imported]] = {
    "movingai": import_movingai,
    "league": import_league,
    "lif": import_lif,
    "rmf": import_rmf,
    "jsplib": import_jsplib,
    "fjs": import_fjs,
    "dxf": import_dxf,
    "svg": import_svg,
}
"""Importers by the name of what they read."""

ENDINGS = (
    (".map", "movingai"),
    (".scen", "movingai"),
    (".building.yaml", "rmf"),
    (".lif.json", "lif"),
    (".lif", "lif"),
    (".fjs", "fjs"),
    (".jsp", "jsplib"),
    (".dxf", "dxf"),
    (".svg", "svg"),
)


def import_file(
    source: Path, folder: Path, kind: str | None = None, options: Options | None = None
) -> Imported:
    """Import ``source`` into ``folder``; ``kind`` is found by the file's ending if it is None.

    :raises UnsupportedError: where the kind is not known.
    """
    if kind is None:
        name = source.name.lower()
        kind = next((k for ending, k in ENDINGS if name.endswith(ending)), None)
    if kind is None or kind not in IMPORTERS:
        known = ", ".join(IMPORTERS)
        raise UnsupportedError(f"'{source}': say what it is (--kind): {known}")
    return IMPORTERS[kind](source, folder, options or Options())


__all__ = ["IMPORTERS", "Imported", "Options", "import_file", "map_from_polygons"]

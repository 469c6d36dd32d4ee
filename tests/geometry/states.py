"""What a map says of a point."""


def state_at(grid, x, y):
    """Return ``"free"``, ``"occupied"``, ``"unknown"`` or ``"outside"`` for a world point."""
    row, col = grid.cells_of([(x, y)])[0]
    rows, cols = grid.shape
    if not (0 <= row < rows and 0 <= col < cols):
        return "outside"
    if grid.occupied[row, col]:
        return "occupied"
    return "unknown" if grid.unknown[row, col] else "free"

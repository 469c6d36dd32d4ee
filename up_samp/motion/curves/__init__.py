"""Curves and their timing: Reeds-Shepp, arcs, trapezoidal speed, blended corners."""

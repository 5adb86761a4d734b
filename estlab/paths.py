"""Where the shipped configuration is."""

from pathlib import Path


def conf_folder() -> Path:
    """conf/, beside the package in a checkout and inside it in an installed wheel."""
    inside = Path(__file__).parent / "conf"
    return inside if inside.is_dir() else Path(__file__).parent.parent / "conf"

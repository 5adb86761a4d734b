"""Draw every figure of the docs again: ``make docs-figures``. Each comes from one estlab command, none by hand."""

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

IMAGES = Path(__file__).parent / "images"

FIGURES = {
    "scenario=car filter=ukf": {
        "trajectory": "car_trajectory",
        "errors": "car_errors",
        "passing": "car_passing",
    },
    "scenario=landmark filter=ukf": {"trajectory": "landmark_trajectory"},
    "+experiment=landmark_commands": {"trajectory": "landmark_commands"},
    "+experiment=radar_i": {"transform": "radar_i"},
    "+experiment=radar_ii": {"transform": "radar_ii"},
    "+experiment=radar_parameters": {"transform": "radar_parameters"},
    "+experiment=gaussian_generator": {"convergence": "radar_generator"},
    "+experiment=sonar_particles": {"nees": "sonar_particles_nees", "cloud_many": "sonar_particles_cloud"},
    "+experiment=sonar_ekf": {"likelihood": "sonar_ekf_likelihood", "trajectory": "sonar_ekf_trajectory"},
    "+experiment=field_errors": {"errors": "field_errors", "trajectory": "field_path"},
    "+experiment=field_sensor_underestimated": {"errors": "field_sensor_underestimated"},
    "+experiment=field_global": {"trajectory": "field_global"},
    "+experiment=epuck_noisy": {"epuck_motion": "epuck_noisy"},
    "+experiment=epuck_smooth": {"epuck_motion": "epuck_smooth"},
    "+experiment=epuck_divergence": {"epuck_motion": "epuck_divergence", "trajectory": "epuck_divergence_trajectory"},
}


def main() -> None:
    """Run each command in a folder of its own and keep its plots, of fewer colours so that files are small."""
    wanted = sys.argv[1:]
    for command, plots in FIGURES.items():
        if wanted and not any(word in command for word in wanted):
            continue
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(
                [sys.executable, "-m", "estlab", "run", *command.split(), f"hydra.run.dir={folder}/run"], check=True
            )
            for plot, name in plots.items():
                image = Image.open(f"{folder}/run/plots/{plot}.png").convert("RGB")
                image.quantize(128).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()

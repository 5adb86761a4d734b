"""Draw every figure of the docs again: ``make docs-figures``. Each comes from one experiment, none by hand."""

import io
import sys
from pathlib import Path

from PIL import Image

import estlab
from estlab.report.figures import png

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
    """Run each experiment in memory and keep its pictures, of fewer colours so that files are small."""
    wanted = sys.argv[1:]
    for command, pictures in FIGURES.items():
        if wanted and not any(word in command for word in wanted):
            continue
        print(command, file=sys.stderr)
        run = estlab.run(*command.split(), save=False, progress=True)
        for picture, name in pictures.items():
            image = Image.open(io.BytesIO(png(run.figure(picture)))).convert("RGB")
            image.quantize(128).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()

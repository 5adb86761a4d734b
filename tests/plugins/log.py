"""A vehicle's log in a CSV file: speed and turn rate at each row, a compass most of the time, GPS once a second."""

from dataclasses import dataclass

import numpy as np

from estlab.errors import UserError
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record
from estlab.scenarios.scenario import Scenario

STATE = Space(("x", "y", "heading"), ("m", "m", "rad"), angles=(2,), position=(0, 1))
READING = Space(("gps_x", "gps_y", "compass"), ("m", "m", "rad"), angles=(2,))


def drive(state, control, noise, dt):
    x, y, heading = state
    speed, turn = control
    faster, sharper = noise
    way = dt * (speed + faster)
    return x + way * np.cos(heading), y + way * np.sin(heading), heading + dt * (turn + sharper)


def look(state, landmark):
    x, y, heading = state
    return x, y, heading


@dataclass(frozen=True)
class Log(Scenario):
    """The columns time, speed, turn, gps_x, gps_y and compass; what is empty was not measured. There is no truth."""

    speed_sd: float
    turn_sd: float
    gps_sd: float
    compass_sd: float

    @property
    def space(self):
        return STATE

    def motion(self, noise):
        cov = noise.process_scale**2 * np.diag([self.speed_sd**2, self.turn_sd**2])
        return Motion(STATE, drive, lambda control, dt: cov / dt, 2)

    def sensor(self, noise, landmarks):
        sds = noise.measurement_scale * np.array([self.gps_sd, self.gps_sd, self.compass_sd])
        return Sensor(READING, STATE, look, np.diag(sds**2), landmarks)

    def simulate(self, streams, runs, noise):
        raise UserError("log simulates nothing; run it with data=files data.path=DIR, the folder of log.csv")

    def read(self, folder, prefix, streams, runs):
        file = folder / f"{prefix}log.csv"
        columns = np.genfromtxt(file, delimiter=",", skip_header=1).T
        time, control, values = columns[0, 1:], columns[1:3, 1:, None], columns[3:, 1:, None]
        first, count, steps = columns[3:, 0], len(runs), time.size
        cov = np.diag([self.gps_sd**2, self.gps_sd**2, self.compass_sd**2])
        error = np.sqrt(cov) @ streams.normals("prior", runs, (3,))
        return Record(
            start=columns[0, 0],
            time=time,
            truth=np.full((3, steps, count), np.nan),
            control=control,
            readings=Readings(np.arange(steps), np.repeat(values, count, axis=2), np.zeros((steps, count), dtype=int)),
            prior=Gaussian(first[:, None] + error, cov),
            files=(file,),
            repeated=True,
        )

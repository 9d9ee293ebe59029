"""Errors of wheels, and of the inertial sensor beside its own noise (room: fusion; host).

In: nothing. Out: MotionNoise, which says how sure an increment is.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionNoise:
    """Errors of wheels and inertial sensor beside scale, bias and `InertialNoise`; all values are ours, of a production
    car.

    Shares act on the distance and are the same over `slip_length_m`; densities grow with the root of the time.
    """

    speed_density_mps: float = 0.01
    """White noise of the speed [m/s per root of the rate in Hz]."""
    slip_share: float = 0.003
    side_slip_share: float = 0.003
    side_slip_per_mps2: float = 0.003
    """Further side slip as a share of the distance for each m/s^2 of lateral acceleration."""
    heave_share: float = 0.01
    slip_length_m: float = 5.0
    gyro_turn_share: float = 0.005
    """Scale error of the gyroscope as a share of the turn."""
    tilt_density_degps: float = 0.2
    """Roll and pitch with a gyroscope: its biases about x and y are not estimated."""
    wheel_yaw_density_degps: float = 0.15
    wheel_turn_share: float = 0.02
    tilt_without_gyro_degps: float = 1.0
    wheel_velocity_mps: tuple[float, float, float] = (0.05, 0.15, 0.3)
    """Of one velocity of the rear axle besides its scale: slip ahead, direction of travel and slip to the side,
    suspension up and down."""
    inertial_acceleration_mps2: float = 0.3
    """Error of the acceleration that the inertial sensor gives while the wheels are silent: slope and pitch change."""
    unknown_acceleration_mps2: float = 2.0
    """What a vehicle may do while its speed is not measured."""
    unknown_yaw_acceleration_degps2: float = 8.0
    """What a vehicle may do while its yaw rate is not measured."""
    unknown_speed_mps: float = 15.0
    unknown_yaw_rate_degps: float = 15.0

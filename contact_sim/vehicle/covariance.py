"""How sure the estimator is: small covariances in plain floats, carried on and corrected."""

from __future__ import annotations

from drone_client.cbf.vector import Vec3


class AxisCovariance:
    """Covariance of place, velocity and acceleration bias along one axis."""

    __slots__ = ("bb", "pb", "pp", "pv", "vb", "vv")

    def __init__(self, sigma_m: float, sigma_mps: float, sigma_mps2: float) -> None:
        self.pp, self.vv, self.bb = sigma_m**2, sigma_mps**2, sigma_mps2**2
        self.pv = self.pb = self.vb = 0.0

    def propagate(self, dt_s: float, q_v: float, q_b: float) -> None:
        """A time later: p' = p + v dt, v' = v + (a - b) dt."""
        pv, vv, pb, vb, bb = self.pv, self.vv, self.pb, self.vb, self.bb
        self.pp += dt_s * (2.0 * pv + dt_s * vv)
        self.pv = pv + dt_s * (vv - pb - dt_s * vb)
        self.pb = pb + dt_s * vb
        self.vv = vv - dt_s * (2.0 * vb - dt_s * bb) + q_v * dt_s
        self.vb = vb - dt_s * bb
        self.bb = bb + q_b * dt_s

    def correct(self, variance: float) -> Vec3:
        """Take a measured place of this variance; gains of place, velocity and bias."""
        k = 1.0 / (self.pp + variance)
        kp, kv, kb = k * self.pp, k * self.pv, k * self.pb
        pv, pb = self.pv, self.pb
        self.pp *= 1.0 - kp
        self.pv = (1.0 - kp) * pv
        self.pb = (1.0 - kp) * pb
        self.vv -= kv * pv
        self.vb -= kv * pb
        self.bb -= kb * pb
        return kp, kv, kb

    def place_known(self, variance: float) -> None:
        """Forget what was believed of the place."""
        self.pp, self.pv, self.pb = variance, 0.0, 0.0


class AngleCovariance:
    """Covariance of an angle and of the gyro bias that makes it drift: the same about any axis."""

    __slots__ = ("aa", "ag", "gg")

    def __init__(self, sigma_rad: float, sigma_radps: float) -> None:
        self.aa, self.gg, self.ag = sigma_rad**2, sigma_radps**2, 0.0

    def propagate(self, dt_s: float, q_a: float, q_g: float) -> None:
        """A time later: a' = a + (w - g) dt."""
        self.aa += dt_s * (dt_s * self.gg - 2.0 * self.ag + q_a)
        self.ag -= dt_s * self.gg
        self.gg += dt_s * q_g

    def correct(self, variance: float) -> tuple[float, float]:
        """Take a measured angle of this variance; gains of angle and bias."""
        k = 1.0 / (self.aa + variance)
        ka, kg, ag = k * self.aa, k * self.ag, self.ag
        self.aa *= 1.0 - ka
        self.ag = (1.0 - ka) * ag
        self.gg -= kg * ag
        return ka, kg

    def angle_known(self, variance: float) -> None:
        """Forget what was believed of the angle."""
        self.aa, self.ag = variance, 0.0

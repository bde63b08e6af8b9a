"""Sigma points of the scaled unscented transform and their weights."""

from __future__ import annotations

from dataclasses import dataclass

from mocap_id.errors import ConfigError


@dataclass(frozen=True)
class SigmaPoints:
    """Parameters of the scaled unscented transform (Merwe).

    A state of L components has 2L + 1 points: the mean, and the mean ± sqrt(c) times each column of the lower Cholesky
    factor of its covariance, c = alpha^2 (L + kappa). The default is c = L with beta = 2. Then the mean point has no
    weight in the mean, and no weight is negative, so the innovation covariance is positive definite for any forward
    map. The angles of a tracked chain are known to a few mrad. Points sqrt(12) standard deviations away are therefore
    still close compared with the curvature of the forward map.
    """

    alpha: float = 1.0  # spread of the points
    beta: float = 2.0  # added to the weight of the mean in the covariance; 2 suits a normal distribution
    kappa: float = 0.0  # second scaling of the spread

    def spread(self, size: int) -> float:
        """Return the factor c for a state of ``size`` components."""
        return self.alpha**2 * (size + self.kappa)

    def weights(self, size: int) -> tuple[float, float, float]:
        """Return the weights of the mean in the mean, of the mean in the covariance, and of every other point in both.

        Raises
        ------
        ConfigError
            c is not positive, or the weight of the mean in the covariance is negative, so that the result may not be a
            covariance.
        """
        c = self.spread(size)
        if c <= 0:
            raise ConfigError(f"sigma points: alpha^2 (L + kappa) is {c:g} for L = {size}; it must be positive")
        mean = 1.0 - size / c
        covariance = mean + 1.0 - self.alpha**2 + self.beta
        if covariance < 0:
            raise ConfigError(
                f"sigma points: alpha {self.alpha:g}, beta {self.beta:g}, kappa {self.kappa:g} give the mean of a"
                f" state of {size} components the weight {covariance:g} in the covariance; it must not be negative"
            )
        return mean, covariance, 0.5 / c

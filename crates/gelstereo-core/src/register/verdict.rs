//! Whether a pose explains a contact, as a program can branch on it.

use crate::math::sqrt;

/// A right pose is called unsure for noise alone once in a hundred times: the normal deviate of 1 %.
const ONE_IN_A_HUNDRED: f64 = 2.326;

/// Whether a pose explains the contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Verdict {
    /// The part is here: the odds are above even, the markers that touch it miss it by no more than their noise explains,
    /// and the steps came to rest.
    Fits,
    /// The part may be here. The odds are above even, but markers that touch miss it by more than noise, or the budget ran
    /// out; or the method does not tell, as none of the methods on samples does.
    Unsure,
    /// The part is elsewhere, or another: the odds are at most even.
    DoesNotFit,
}

impl Verdict {
    /// From the odds, the mean squared deviation of the markers that touch, in variances, with their number, and whether the
    /// steps came to rest.
    pub(super) fn new(log_odds: f64, touching: Option<(f64, f64)>, converged: bool) -> Self {
        if log_odds <= 0.0 {
            return Self::DoesNotFit;
        }
        let is_noise = touching.is_none_or(|(squared, count)| squared <= usual_mean_square(count));
        if is_noise && converged { Self::Fits } else { Self::Unsure }
    }

    /// For a program or a person: `fits`, `unsure` or `does_not_fit`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fits => "fits",
            Self::Unsure => "unsure",
            Self::DoesNotFit => "does_not_fit",
        }
    }
}

/// What the mean of the squares of so many normal deviates exceeds once in a hundred times (Wilson and Hilferty 1931).
fn usual_mean_square(count: f64) -> f64 {
    let variance = 2.0 / (9.0 * count.max(1.0));
    let root = 1.0 - variance + ONE_IN_A_HUNDRED * sqrt(variance);
    root * root * root
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of 99 % from a table of the chi-squared distribution, over its degrees of freedom.
    #[test]
    fn the_limit_is_the_chi_squared_distributions() {
        for (count, quantile) in [(5.0, 15.086), (10.0, 23.209), (30.0, 50.892), (100.0, 135.807)] {
            let (found, wanted) = (usual_mean_square(count), quantile / count);
            // The approximation's own error, at most 0.3 % from five degrees on.
            assert!((found / wanted - 1.0).abs() < 3e-3, "{count}: {found} for {wanted}");
        }
    }

    #[test]
    fn a_pose_fits_only_if_odds_misfit_and_end_agree() {
        assert_eq!(Verdict::new(3.0, Some((1.0, 30.0)), true), Verdict::Fits);
        assert_eq!(Verdict::new(3.0, None, true), Verdict::Fits);
        assert_eq!(Verdict::new(3.0, Some((1.8, 30.0)), true), Verdict::Unsure);
        assert_eq!(Verdict::new(3.0, Some((1.0, 30.0)), false), Verdict::Unsure);
        assert_eq!(Verdict::new(0.0, Some((1.0, 30.0)), true), Verdict::DoesNotFit);
    }
}

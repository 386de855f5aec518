//! Verdict on whether a pose explains a contact, for use in programs.

use crate::math::sqrt;

/// Log odds of 100 to 1, which either verdict needs: a claim that the part is elsewhere is one as well.
const SURE_LOG: f64 = 4.605;
/// Normal deviate of 1 %: noise alone makes a correct pose unsure once in a hundred times.
const ONE_IN_A_HUNDRED: f64 = 2.326;

/// Whether a pose explains the contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Verdict {
    /// The part is here: the odds are above 100 to 1, the residuals of markers in contact are explained by
    /// noise, and the steps converged.
    Fits,
    /// The part may be here. The odds are between 1 to 100 and 100 to 1, residuals of markers in contact
    /// exceed the noise, or the budget ran out. Also if the method gives no verdict, as all methods on
    /// samples.
    Unsure,
    /// The part is elsewhere, or another: the odds are at most 1 to 100.
    DoesNotFit,
}

/// Squared residuals over their variances: their mean and number.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeanSquare {
    pub mean: f64,
    pub count: f64,
}

impl Verdict {
    /// From the log odds, the residuals of the markers in contact, and whether the steps converged.
    pub(super) fn new(log_odds: f64, touching: Option<MeanSquare>, converged: bool) -> Self {
        if log_odds <= -SURE_LOG {
            return Self::DoesNotFit;
        }
        let is_noise = touching.is_none_or(|it| it.mean <= usual_mean_square(it.count));
        if log_odds > SURE_LOG && is_noise && converged { Self::Fits } else { Self::Unsure }
    }

    /// Identifier: `fits`, `unsure` or `does_not_fit`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fits => "fits",
            Self::Unsure => "unsure",
            Self::DoesNotFit => "does_not_fit",
        }
    }
}

/// 99 % quantile of the mean of `count` squared normal deviates (Wilson and Hilferty 1931).
fn usual_mean_square(count: f64) -> f64 {
    let variance = 2.0 / (9.0 * count.max(1.0));
    let root = 1.0 - variance + ONE_IN_A_HUNDRED * sqrt(variance);
    root * root * root
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 99 % quantiles from a table of the chi-squared distribution, by degrees of freedom.
    #[test]
    fn the_limit_is_the_chi_squared_distributions() {
        for (count, quantile) in [(5.0, 15.086), (10.0, 23.209), (30.0, 50.892), (100.0, 135.807)] {
            let (found, wanted) = (usual_mean_square(count), quantile / count);
            // The approximation's own error is at most 0.3 % from five degrees on.
            assert!((found / wanted - 1.0).abs() < 3e-3, "{count}: {found} for {wanted}");
        }
    }

    #[test]
    fn a_pose_fits_only_if_odds_misfit_and_end_agree() {
        let of = |mean| Some(MeanSquare { mean, count: 30.0 });
        assert_eq!(Verdict::new(5.0, of(1.0), true), Verdict::Fits);
        assert_eq!(Verdict::new(5.0, None, true), Verdict::Fits);
        assert_eq!(Verdict::new(5.0, of(1.8), true), Verdict::Unsure);
        assert_eq!(Verdict::new(5.0, of(1.0), false), Verdict::Unsure);
        assert_eq!(Verdict::new(-5.0, of(1.0), true), Verdict::DoesNotFit);
        for odds in [-99.0_f64, -2.0, 1.0, 2.0, 99.0] {
            let log = odds.signum() * crate::math::ln(odds.abs());
            assert_eq!(Verdict::new(log, of(1.0), true), Verdict::Unsure, "{odds}");
        }
    }
}

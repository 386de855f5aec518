//! Centring rung chosen by the settings.

use super::CentreRung;
use super::binary::BinaryCentroid;
use super::fit::DiscFit;
use super::soft_threshold::SoftThreshold;
use super::weighted::WeightedCentroid;
use crate::detect::workload::Workload;
use crate::params::{Centre, DetectParams};
use alloc::boxed::Box;

/// One of the centring rungs.
#[derive(Clone, Debug)]
pub(in crate::detect) enum Rung {
    Binary(BinaryCentroid),
    Grey(WeightedCentroid),
    SoftThreshold(Box<SoftThreshold>),
    Fit(Box<DiscFit>),
}

impl Rung {
    /// Creates the rung that the settings choose.
    pub fn new(params: &DetectParams) -> Self {
        match params.centre {
            Centre::Binary => Self::Binary(BinaryCentroid::new(params)),
            Centre::Grey => Self::Grey(WeightedCentroid::new(params)),
            Centre::SoftThreshold => Self::SoftThreshold(Box::new(SoftThreshold::new(params))),
            Centre::Fit => Self::Fit(Box::new(DiscFit::new(params))),
        }
    }

    /// Adds what the last image showed of the work of later ones.
    pub fn add_workload(&self, workload: &mut Workload) {
        match self {
            Self::Binary(_) | Self::Grey(_) => {}
            Self::SoftThreshold(rung) => rung.add_workload(workload),
            Self::Fit(rung) => rung.add_workload(workload),
        }
    }

    pub fn get(&mut self) -> &mut dyn CentreRung {
        match self {
            Self::Binary(rung) => rung,
            Self::Grey(rung) => rung,
            Self::SoftThreshold(rung) => rung.as_mut(),
            Self::Fit(rung) => rung.as_mut(),
        }
    }
}

//! Force and torque of a contact.

use super::{ParamsError, check};

/// How tractions and the wrench are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum ForceMethod {
    /// They are not.
    #[default]
    None,
    /// The wrench from sums of the markers' motion, with the stiffness that known loads gave. Its tractions
    /// are the force, spread like the heights. Needs no modulus; its error is 5 to 15 %.
    Resultant,
    /// The most probable tractions on the cells of the contact, which may also pull.
    Ridge,
    /// The most probable ones of which none pulls, and none drags by more than `friction` times its pressure.
    /// The wrench is that of `ridge`, which is more accurate: with coarse cells, bounds bias the sum.
    Bounded,
}

/// Force and torque of a contact, from the motion of the markers and the gel's elasticity.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct ForceParams {
    /// How tractions and the wrench are computed. Default: `none`. Set `bounded` once `young_kpa` and
    /// `thickness_mm` are known.
    pub method: ForceMethod,
    /// Thickness of the gel, from the plate that it is bonded to, to its skin. Valid: 0.1 to 1000 mm.
    /// Default: none. Set it for every method.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub thickness_mm: Option<f64>,
    /// Standard deviation of `thickness_mm`, for `ridge` and `bounded`. Valid: 0 to 1000 mm. Default: `0` mm.
    /// Set it to what `gelstereo setup` states, unless `young_kpa` was calibrated with this thickness: that
    /// modulus makes up for its error.
    pub thickness_sigma_mm: f64,
    /// Gel beyond the outermost markers, up to its free sides, for `ridge` and `bounded`; rounded to half a
    /// pitch. Sides farther than 64 pitches are none. Valid: 0.001 to 1000 mm. Default: none, the gel has no
    /// end. Set it where the gel is narrow for its thickness.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub rim_mm: Option<f64>,
    /// Young's modulus of the gel. Forces are proportional to it. Valid: 0.001 to 1000000 kPa. Default:
    /// none. Set it for every method, to what a known weight tells.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub young_kpa: Option<f64>,
    /// Standard deviation of `young_kpa`, which all forces share. Valid: 0 to 1000000 kPa. Default: `0` kPa.
    /// Set it to what the calibration states.
    pub young_sigma_kpa: f64,
    /// Relative rise of the loads for each unit of strain, which is the deepest indentation over the
    /// thickness; for `ridge` and `bounded`. Valid: 0 to 10. Default: `0`, a linear gel. Set it to 0.26 for a
    /// neo-Hookean gel whose sides are known, by `rim_mm` or a compliance matrix, and whose modulus is
    /// that of gentle presses.
    pub stiffening: f64,
    /// Relative standard deviation of the loads for each unit of strain, which is the deepest indentation
    /// over the thickness, since a gel is no linear layer; for `ridge` and `bounded`. Valid: 0 to 10.
    /// Default: `0.2`, of neo-Hookean gels solved by finite elements. Set it to 0 for a gel that is a linear
    /// layer, as the simulator's.
    pub strain_sigma: f64,
    /// Poisson's ratio of the gel. Valid: 0 to 0.5. Default: `0.48`, of soft silicone.
    /// Change it if it was measured.
    pub poisson_ratio: f64,
    /// Standard deviation of `poisson_ratio`, for `ridge` and `bounded`. Valid: 0 to 0.5. Default: `0`. Set
    /// it where the ratio is a guess, unless `young_kpa` was calibrated with it.
    pub poisson_sigma: f64,
    /// Coulomb's coefficient between gel and part, for `bounded`. Valid: 0 to 100. Default: none, a cell may
    /// be dragged by any traction where it is pressed. Set it if it is known.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub friction: Option<f64>,
    /// Standard deviation of `friction`, for the range of a slip margin. Valid: 0 to 100. Default: `0`. Set
    /// it to what `gelstereo setup` states.
    pub friction_sigma: f64,
    /// For `resultant`: pressing force for each volume of gel displaced under the part, in addition to
    /// `around_n_per_mm3`. Valid: -1000 to 1000 N/mm³. Default: none. Set it to what `gelstereo
    /// calibrate-force --method resultant` finds.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub patch_n_per_mm3: Option<f64>,
    /// For `resultant`: pressing force for each volume of gel displaced under the part and up to one
    /// thickness around it. Valid: -1000 to 1000 N/mm³. Default: none. Set it to what the calibration finds.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub around_n_per_mm3: Option<f64>,
    /// For `resultant`: force along the gel for each millimetre of motion of each square millimetre of gel,
    /// up to one thickness around the part. Valid: 0 to 1000 N/mm³. Default: none. Set it to what the
    /// calibration finds.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub shear_n_per_mm3: Option<f64>,
    /// For `resultant`: relative standard deviation of the loads. Valid: 0 to 10. Default: `0.1`, of
    /// simulated balls, plates and cylinders. Set it to what the calibration finds.
    pub resultant_sigma: f64,
}

impl Default for ForceParams {
    fn default() -> Self {
        Self {
            method: ForceMethod::None,
            thickness_mm: None,
            thickness_sigma_mm: 0.0,
            rim_mm: None,
            young_kpa: None,
            young_sigma_kpa: 0.0,
            stiffening: 0.0,
            strain_sigma: 0.2,
            poisson_ratio: 0.48,
            poisson_sigma: 0.0,
            friction: None,
            friction_sigma: 0.0,
            patch_n_per_mm3: None,
            around_n_per_mm3: None,
            shear_n_per_mm3: None,
            resultant_sigma: 0.1,
        }
    }
}

impl ForceParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let number = |name, found: Option<f64>, range: core::ops::RangeInclusive<f64>, valid| {
            found.map_or(Ok(()), |found| check(range.contains(&found), name, found, valid))
        };
        number("force.thickness_mm", self.thickness_mm, 0.1..=1e3, "0.1 to 1000 mm")?;
        number("force.thickness_sigma_mm", Some(self.thickness_sigma_mm), 0.0..=1e3, "0 to 1000 mm")?;
        number("force.rim_mm", self.rim_mm, 1e-3..=1e3, "0.001 to 1000 mm")?;
        number("force.young_kpa", self.young_kpa, 1e-3..=1e6, "0.001 to 1000000 kPa")?;
        number("force.young_sigma_kpa", Some(self.young_sigma_kpa), 0.0..=1e6, "0 to 1000000 kPa")?;
        number("force.stiffening", Some(self.stiffening), 0.0..=10.0, "0 to 10")?;
        number("force.strain_sigma", Some(self.strain_sigma), 0.0..=10.0, "0 to 10")?;
        number("force.poisson_ratio", Some(self.poisson_ratio), 0.0..=0.5, "0 to 0.5")?;
        number("force.poisson_sigma", Some(self.poisson_sigma), 0.0..=0.5, "0 to 0.5")?;
        number("force.friction", self.friction, 0.0..=100.0, "0 to 100")?;
        number("force.friction_sigma", Some(self.friction_sigma), 0.0..=100.0, "0 to 100")?;
        for (name, found) in [
            ("force.patch_n_per_mm3", self.patch_n_per_mm3),
            ("force.around_n_per_mm3", self.around_n_per_mm3),
        ] {
            number(name, found, -1e3..=1e3, "-1000 to 1000 N/mm³")?;
        }
        number("force.shear_n_per_mm3", self.shear_n_per_mm3, 0.0..=1e3, "0 to 1000 N/mm³")?;
        number("force.resultant_sigma", Some(self.resultant_sigma), 0.0..=10.0, "0 to 10")?;
        self.check_needs()
    }

    /// Checks that what the method needs is there.
    fn check_needs(&self) -> Result<(), ParamsError> {
        let thickness = (self.thickness_mm, "force.thickness_mm");
        let layer = [thickness, (self.young_kpa, "force.young_kpa")];
        let stiffness = [
            thickness,
            (self.patch_n_per_mm3, "force.patch_n_per_mm3"),
            (self.around_n_per_mm3, "force.around_n_per_mm3"),
            (self.shear_n_per_mm3, "force.shear_n_per_mm3"),
        ];
        let (setting, needs) = match self.method {
            ForceMethod::None => return Ok(()),
            ForceMethod::Resultant => ("force.method = \"resultant\"", &stiffness[..]),
            ForceMethod::Ridge => ("force.method = \"ridge\"", &layer[..]),
            ForceMethod::Bounded => ("force.method = \"bounded\"", &layer[..]),
        };
        match needs.iter().find(|(found, _)| found.is_none()) {
            Some(&(_, required)) => Err(ParamsError::Requires { setting, required }),
            None => Ok(()),
        }
    }
}

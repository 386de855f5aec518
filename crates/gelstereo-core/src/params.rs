//! The one tree of settings. [`Params::default`] is the paper's, section V-B.
//!
//! A ladder's rungs are the variants of one enum here; each says what it costs and what it gives.
//! `docs/accuracy-vs-time.md` holds the measured figures.

/// All settings of the pipeline and of registration.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Params {
    /// The printed lattice.
    pub lattice: LatticeParams,
    /// Finding markers in one image.
    pub detect: DetectParams,
    /// Keeping their identity over frames.
    pub track: TrackParams,
    /// Row and column of every marker.
    pub label: LabelParams,
    /// From two views to millimetres.
    pub triangulate: TriangulateParams,
    /// Saliency and the stop triggers.
    pub contact: ContactParams,
    /// Registration to the template.
    pub register: RegisterParams,
}

/// The printed lattice.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct LatticeParams {
    /// Markers from top to bottom. Default: `25`.
    pub rows: usize,
    /// Markers from left to right. Default: `25`.
    pub cols: usize,
    /// Distance between neighbours. Default: `0.9` mm.
    pub pitch_mm: f64,
    /// How many printed markers may be missing in the rest frame; they are filled in from their neighbours, as the
    /// paper does for the corner that its print lacks (Fig. 4). Default: `6`, 1 % of 625.
    pub max_missing: usize,
}

impl Default for LatticeParams {
    fn default() -> Self {
        Self { rows: 25, cols: 25, pitch_mm: 0.9, max_missing: 6 }
    }
}

impl LatticeParams {
    /// N, the number of markers.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.rows * self.cols
    }

    /// Whether the lattice has no markers.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Whether markers are darker or brighter than the gel around them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Polarity {
    /// Dark dots on a bright gel (the paper).
    #[default]
    Dark,
    /// Bright dots on a dark gel.
    Bright,
}

/// How the surround's brightness is estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Background {
    /// Gaussian of `background_kernel_px` (the paper): the slowest stage of all.
    #[default]
    Gaussian,
    /// Mean over a square of `background_kernel_px`: constant cost per pixel.
    Box,
}

/// How a component becomes a centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Centre {
    /// Mean position of the component's pixels (the paper): about 0.13 px rms.
    #[default]
    Binary,
    /// Mean position weighted by contrast over the component and its border: about 0.05 px rms.
    Grey,
}

/// Finding markers in one image.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct DetectParams {
    /// Default: `dark`.
    pub polarity: Polarity,
    /// Default: `gaussian`.
    pub background: Background,
    /// Default: `binary`.
    pub centre: Centre,
    /// Side of the Gaussian kernel that removes pixel noise, odd. Default: `3` px.
    pub smooth_kernel_px: usize,
    /// Side of the kernel that estimates the surround, odd. Default: `51` px.
    pub background_kernel_px: usize,
    /// A pixel belongs to a marker when it differs from its surround by at least this. The paper's threshold is 220
    /// on the inverted, saturating difference, that is 255 - 220. Default: `35` grey levels.
    pub threshold_levels: u8,
    /// Side of the elliptic kernel of dilation and erosion, odd; 1 changes nothing. Default: `1` px.
    pub morphology_kernel_px: usize,
    /// Smallest marker. Default: `6` px².
    pub min_area_px2: u32,
    /// Largest marker. Default: `2000` px².
    pub max_area_px2: u32,
    /// Least area over that of the bounding box's inscribed ellipse; scratches and merged pairs have less.
    /// Default: `0.5`.
    pub min_fill: f64,
}

impl Default for DetectParams {
    fn default() -> Self {
        Self {
            polarity: Polarity::Dark,
            background: Background::Gaussian,
            centre: Centre::Binary,
            smooth_kernel_px: 3,
            background_kernel_px: 51,
            threshold_levels: 35,
            morphology_kernel_px: 1,
            min_area_px2: 6,
            max_area_px2: 2000,
            min_fill: 0.5,
        }
    }
}

/// Keeping the identity of markers over frames.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct TrackParams {
    /// A detection farther than this from a marker's last position is not that marker (Eq. 2). Default: `0.5` pitches.
    pub gate_pitches: f64,
    /// A marker unseen for more frames than this is lost until it is seen again. Default: `15`, half a second.
    pub max_held_frames: u32,
}

impl Default for TrackParams {
    fn default() -> Self {
        Self { gate_pitches: 0.5, max_held_frames: 15 }
    }
}

/// How rows and columns are kept after the rest frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum LabelMethod {
    /// Foresight sort of every frame (the paper, Algorithm 1): exact to about 5 degrees of lattice rotation.
    #[default]
    Foresight,
    /// A marker keeps the row and column of the rest frame through its track.
    Temporal,
}

/// Row and column of every marker.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct LabelParams {
    /// Default: `foresight`.
    pub method: LabelMethod,
    /// l of Algorithm 1: markers of one row are at least this far apart in x. Default: `1/3` pitch.
    pub tolerance_pitches: f64,
}

impl Default for LabelParams {
    fn default() -> Self {
        Self { method: LabelMethod::Foresight, tolerance_pitches: 1.0 / 3.0 }
    }
}

/// From two views to millimetres.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct TriangulateParams {
    /// Smallest disparity that has a meaning; it bounds the depth at f B / min. Default: `1` px.
    pub min_disparity_px: f64,
    /// Largest distance between the rectified rows of one marker. Default: `3` px, five times the paper's 0.64.
    pub max_epipolar_px: f64,
    /// Standard deviation of a centre per axis, for the covariance of points. Default: `0.09` px, the paper's binary
    /// centroid.
    pub centre_sigma_px: f64,
}

impl Default for TriangulateParams {
    fn default() -> Self {
        Self { min_disparity_px: 1.0, max_epipolar_px: 3.0, centre_sigma_px: 0.09 }
    }
}

/// Saliency and the stop triggers.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct ContactParams {
    /// Indentation from which a marker is salient (Eq. 4). Default: `0.35` mm.
    pub saliency_mm: f64,
    /// Share of the deepest indentation that a salient marker must reach to belong to the contact patch, which is what is
    /// registered. Beside a deep press the gel is lifted too, but shows no surface of the part; where a ball or a
    /// cylinder leaves the gel, that has sunk about half as deep as in the middle (Hertz). Default: `0`, all of them.
    pub patch_share: f64,
    /// Mean marker motion at which the gripper stops closing. Default: `10` px.
    pub grasp_trigger_px: f64,
    /// Mean marker motion at which insertion stops. Default: `5` px.
    pub insertion_trigger_px: f64,
}

impl Default for ContactParams {
    fn default() -> Self {
        Self { saliency_mm: 0.35, patch_share: 0.0, grasp_trigger_px: 10.0, insertion_trigger_px: 5.0 }
    }
}

/// How a contact patch is registered to a template.
///
/// The figures are the starts, 5 degrees and 1 mm off, that end within 0.15 mm on a cylinder, two balls and a ridge with
/// all salient markers, and the median time (simulated, noise 2 grey levels; `gelstereo frontier`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum RegisterMethod {
    /// FilterReg, point to point (the paper): 80 / 100 / 36 %, 24 ms.
    #[default]
    FilterregPoint,
    /// FilterReg, point to plane, with a one-sided model of the gel's shoulder: 100 / 100 / 100 %, 10 ms.
    FilterregPlane,
    /// RANSAC, then point-to-point ICP (the paper's comparison): 88 / 100 / 12 %, 51 ms.
    RansacIcp,
    /// Point-to-plane ICP alone, from the guess, with the same model of the shoulder: 100 / 100 / 89 %, 1.4 ms.
    IcpPlane,
}

/// Registration of a contact patch to a template.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct RegisterParams {
    /// Default: `filterreg_point`.
    pub method: RegisterMethod,
    /// Most iterations of the last stage. Default: `100`.
    pub max_iterations: u32,
    /// Converged when a step moves no point of the patch by more than this share of the template's spacing.
    /// Default: `1e-3`, 0.3 µm at 0.3 mm: a hundredth of a point's noise. Only the directions that the contact
    /// determines count; point-to-point rungs creep along flat faces and may run out of iterations there.
    pub step_tolerance: f64,
    /// Width of the first Gaussian of FilterReg. Default: `0.7` mm.
    pub sigma_start_mm: f64,
    /// Width below which the Gaussian does not shrink. Default: `0.1` mm.
    pub sigma_floor_mm: f64,
    /// Share of points that lie on no surface (w of FilterReg). Default: `0.1`.
    pub outlier_share: f64,
    /// Pairs farther apart are no correspondences (ICP, RANSAC), and inliers are counted within it. Default: `1` mm.
    pub max_distance_mm: f64,
    /// Standard deviation of a salient point along the surface's normal; it scales the information matrix.
    /// Default: `0.03` mm.
    pub point_sigma_mm: f64,
    /// Hypotheses of RANSAC. Default: `2000`.
    pub ransac_hypotheses: u32,
    /// Farthest a RANSAC hypothesis may move the patch's centroid from the guess, and farthest that FilterReg accepts the
    /// patch from the template at the guess. Default: `3` mm: at 5 mm, the faces of a small box are taken for each other.
    pub search_radius_mm: f64,
    /// Seed of RANSAC's random stream. Default: `1`.
    pub seed: u64,
}

impl Default for RegisterParams {
    fn default() -> Self {
        Self {
            method: RegisterMethod::FilterregPoint,
            max_iterations: 100,
            step_tolerance: 1e-3,
            sigma_start_mm: 0.7,
            sigma_floor_mm: 0.1,
            outlier_share: 0.1,
            max_distance_mm: 1.0,
            point_sigma_mm: 0.03,
            ransac_hypotheses: 2000,
            search_radius_mm: 3.0,
            seed: 1,
        }
    }
}

/// A setting that makes no sense.
#[derive(Clone, Debug, PartialEq)]
pub struct ParamsError {
    /// Where it stands, for example `detect.smooth_kernel_px`.
    pub name: &'static str,
    /// What was found.
    pub found: f64,
    /// What would be valid.
    pub valid: &'static str,
}

impl core::fmt::Display for ParamsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} is {}; valid is {}", self.name, self.found, self.valid)
    }
}

impl core::error::Error for ParamsError {}

impl Params {
    /// The preset of that name, or `None`; [`Self::PRESETS`] lists them.
    ///
    /// `paper` is the paper's pipeline to the letter, `balanced` its cheaper and more accurate variant: box
    /// background, grey centroids, labels kept through tracks, the gel's shoulder left out, point-to-plane registration.
    #[must_use]
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "paper" => Some(Self::default()),
            "balanced" => Some(Self {
                detect: DetectParams {
                    background: Background::Box,
                    centre: Centre::Grey,
                    ..Default::default()
                },
                label: LabelParams { method: LabelMethod::Temporal, ..Default::default() },
                triangulate: TriangulateParams { centre_sigma_px: 0.04, ..Default::default() },
                contact: ContactParams { patch_share: 0.65, ..Default::default() },
                register: RegisterParams { method: RegisterMethod::FilterregPlane, ..Default::default() },
                ..Self::default()
            }),
            _ => None,
        }
    }

    /// Names that [`Self::preset`] knows.
    pub const PRESETS: [&'static str; 2] = ["paper", "balanced"];

    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let odd = |name, x: usize, most: usize| {
            check(
                x % 2 == 1 && x <= most,
                name,
                x as f64,
                if most == 255 { "odd, 1 to 255" } else { "odd, 1 to 31" },
            )
        };
        let side = |name, n: usize| check((2..=1000).contains(&n), name, n as f64, "2 to 1000 markers");
        side("lattice.rows", self.lattice.rows)?;
        side("lattice.cols", self.lattice.cols)?;
        positive("lattice.pitch_mm", self.lattice.pitch_mm)?;
        let d = &self.detect;
        odd("detect.smooth_kernel_px", d.smooth_kernel_px, 31)?;
        odd("detect.background_kernel_px", d.background_kernel_px, 255)?;
        odd("detect.morphology_kernel_px", d.morphology_kernel_px, 31)?;
        check(d.threshold_levels > 0, "detect.threshold_levels", f64::from(d.threshold_levels), "1 to 255")?;
        let areas_ok = d.min_area_px2 >= 1 && d.max_area_px2 >= d.min_area_px2;
        check(areas_ok, "detect.min_area_px2", f64::from(d.min_area_px2), "1 to detect.max_area_px2")?;
        check((0.0..=1.0).contains(&d.min_fill), "detect.min_fill", d.min_fill, "from 0 to 1")?;
        let gate = self.track.gate_pitches;
        check(gate > 0.0 && gate <= 1.0, "track.gate_pitches", gate, "above 0, at most 1")?;
        let l = self.label.tolerance_pitches;
        check(l > 0.0 && l < 1.0, "label.tolerance_pitches", l, "above 0, below 1")?;
        positive("triangulate.min_disparity_px", self.triangulate.min_disparity_px)?;
        positive("triangulate.max_epipolar_px", self.triangulate.max_epipolar_px)?;
        positive("triangulate.centre_sigma_px", self.triangulate.centre_sigma_px)?;
        positive("contact.saliency_mm", self.contact.saliency_mm)?;
        let share = self.contact.patch_share;
        check((0.0..1.0).contains(&share), "contact.patch_share", share, "from 0 to below 1")?;
        positive("contact.grasp_trigger_px", self.contact.grasp_trigger_px)?;
        positive("contact.insertion_trigger_px", self.contact.insertion_trigger_px)?;
        self.register.validate()
    }
}

impl RegisterParams {
    /// Checks every setting of registration against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let r = self;
        let share = |name, x: f64| check((0.0..1.0).contains(&x), name, x, "from 0 to below 1");
        check(r.max_iterations >= 1, "register.max_iterations", f64::from(r.max_iterations), "at least 1")?;
        positive("register.step_tolerance", r.step_tolerance)?;
        positive("register.sigma_floor_mm", r.sigma_floor_mm)?;
        let start_ok = r.sigma_start_mm >= r.sigma_floor_mm && r.sigma_start_mm.is_finite();
        check(
            start_ok,
            "register.sigma_start_mm",
            r.sigma_start_mm,
            "finite, at least register.sigma_floor_mm",
        )?;
        share("register.outlier_share", r.outlier_share)?;
        positive("register.max_distance_mm", r.max_distance_mm)?;
        positive("register.point_sigma_mm", r.point_sigma_mm)?;
        check(
            r.ransac_hypotheses >= 1,
            "register.ransac_hypotheses",
            f64::from(r.ransac_hypotheses),
            "at least 1",
        )?;
        positive("register.search_radius_mm", r.search_radius_mm)
    }
}

fn check(ok: bool, name: &'static str, found: f64, valid: &'static str) -> Result<(), ParamsError> {
    if ok { Ok(()) } else { Err(ParamsError { name, found, valid }) }
}

fn positive(name: &'static str, x: f64) -> Result<(), ParamsError> {
    check(x > 0.0 && x.is_finite(), name, x, "a finite number above 0")
}

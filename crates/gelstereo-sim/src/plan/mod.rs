//! Selection of the effects that a scene needs.
//!
//! A scene may state its requirements ([`Asked`]) and switches for its effects ([`Switches`]). Before
//! the simulation, every effect computes an upper bound of the change it causes ([`Bound`]). Effects on
//! auto are switched off in order of increasing bound, as long as the sum of all switched-off bounds
//! stays within the tolerance. Each bound holds whichever other effects are on. The simulation is
//! therefore within the tolerance of the full scene, in every frame of its trajectory. (Contacts off the
//! trajectory use the same effects without that guarantee; without a trajectory the bounds hold for
//! every contact.)
//!
//! Effects that are off are removed from the scene before the simulator is built, as if the scene never
//! had them.

mod asked;
mod bound;
mod facts;
mod passage;

pub use crate::effects::Switches;
pub use asked::{Asked, Switch};
pub use bound::Bound;

pub(crate) use bound::Effect;
pub(crate) use facts::Facts;

use crate::effects::Optics;
use crate::scene::{Scene, SceneError};
use crate::shapes::Solid;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use gelstereo_core::surface::TriangleMesh;

/// The effects that are computed for a scene, with reasons.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The scene's requirement.
    pub asked: Option<Asked>,
    /// Every effect of the scene, in list order.
    pub entries: Vec<Entry>,
    /// The simulated scene: without the effects that are off.
    pub scene: Scene,
}

/// One effect of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Its name in a scene file; `refraction`, `lens_distortion` and `ellipse_bias` belong to the rig.
    pub effect: &'static str,
    /// Upper bound of the change it causes.
    pub bound: Bound,
    /// Whether it is computed.
    pub on: bool,
    /// Reason.
    pub why: Why,
    /// Estimated time per stereo frame while it is on, nanoseconds.
    pub cost_ns: f64,
}

/// Reason why an effect is on or off.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "snake_case"))]
pub enum Why {
    /// The scene has no requirement, so everything is computed.
    NothingAsked,
    /// Set by the scene's switches.
    Switched,
    /// The sum of its bound and those of all effects switched off before it is within the tolerance.
    WithinTolerance {
        /// Sum of the bounds up to this one, in the requirement's unit.
        sum: f64,
    },
    /// That sum exceeds the tolerance.
    BeyondTolerance {
        /// Sum of the bounds up to this one.
        sum: f64,
    },
}

impl Plan {
    /// Plans a scene; `meshes` are the surfaces of the parts whose shapes are mesh files, in their order.
    ///
    /// # Errors
    /// As [`crate::Simulator::new`].
    pub fn of<'a>(
        scene: &'a Scene,
        meshes: impl IntoIterator<Item = &'a TriangleMesh>,
    ) -> Result<Self, SceneError> {
        scene.validate()?;
        let parts = Solid::of(scene, meshes)?;
        // Bounds are computed without the effects that are forced off. Those of the forced-off effects
        // themselves use the whole scene.
        let forced_off = |effect: &str| scene.switches.of(effect) == Some(Switch::Off);
        let rest = without(scene, forced_off);
        let rest = described(&Facts::of(&rest, &parts));
        let whole = described(&Facts::of(scene, &parts));
        let entry = |(effect, bound, cost_ns)| {
            let switch = scene.switches.of(effect);
            let why = if switch.is_none() { Why::NothingAsked } else { Why::Switched };
            let entry = Entry { effect, bound, on: !forced_off(effect), why, cost_ns };
            match rest.iter().find(|&&(name, ..)| name == effect && entry.on) {
                Some(&(_, bound, cost_ns)) => Entry { bound, cost_ns, ..entry },
                None => entry,
            }
        };
        let mut entries: Vec<Entry> = whole.into_iter().map(entry).collect();
        if let Some(asked) = &scene.asked {
            decide(asked, &scene.switches, &mut entries);
        }
        let is_off = |effect: &str| entries.iter().any(|entry| entry.effect == effect && !entry.on);
        let pruned = without(scene, is_off);
        Ok(Self { asked: scene.asked, scene: pruned, entries })
    }

    /// Upper bound of the joint change by the effects that are off on auto, in the requirement's unit.
    #[must_use]
    pub fn left_out(&self) -> f64 {
        let sums = self.entries.iter().map(|entry| match entry.why {
            Why::WithinTolerance { sum } => sum,
            _ => 0.0,
        });
        sums.fold(0.0, f64::max)
    }

    /// Estimated time of all effects that are on, nanoseconds per stereo frame.
    #[must_use]
    pub fn cost_ns(&self) -> f64 {
        self.entries.iter().filter(|entry| entry.on).map(|entry| entry.cost_ns).sum()
    }
}

/// Name, bound and cost of every effect that a scene has.
fn described(facts: &Facts<'_>) -> Vec<(&'static str, Bound, f64)> {
    let own = Optics::ALL.into_iter().filter(|effect| effect.is_in(facts.scene));
    let listed =
        facts.scene.effects.listed().map(|(name, effect)| (name, effect.bound(facts), effect.cost_ns(facts)));
    let all = listed.chain(own.map(|effect| (effect.name(), effect.bound(facts), effect.cost_ns(facts))));
    all.map(|(name, bound, cost_ns)| (name, behind(facts, name, bound), cost_ns)).collect()
}

/// Adds to a bound in grey levels the change in later image effects that depend on their input.
fn behind(facts: &Facts<'_>, effect: &str, bound: Bound) -> Bound {
    let effects = &facts.scene.effects;
    let mut levels = bound.levels;
    let before = |later: &[&str]| levels > 0.0 && !later.contains(&effect);
    let shots = effects.shot_noise.as_ref().filter(|_| before(&["shot_noise", "sensor_noise", "jpeg"]));
    let jpeg = effects.jpeg.as_ref().filter(|_| before(&["jpeg"]));
    // √a - √b <= √(a - b), and levels are rounded before the lookup.
    levels += shots.map_or(0.0, |shots| shots.most_levels(levels + 1.0));
    // Each of the two images is off by up to this bound.
    levels += jpeg.map_or(0.0, |jpeg| 2.0 * jpeg.bound(facts).levels + 1.0);
    Bound { levels, ..bound }
}

/// Switches off effects on auto, in order of increasing bound.
fn decide(asked: &Asked, switches: &Switches, entries: &mut [Entry]) {
    let mut auto: Vec<usize> = (0..entries.len())
        .filter(|&i| matches!(switches.of(entries[i].effect), None | Some(Switch::Auto)))
        .collect();
    auto.sort_by(|&a, &b| asked.of(&entries[a].bound).total_cmp(&asked.of(&entries[b].bound)));
    let mut sum = 0.0;
    for i in auto {
        sum += asked.of(&entries[i].bound);
        entries[i].on = !(sum <= asked.tolerance());
        entries[i].why =
            if entries[i].on { Why::BeyondTolerance { sum } } else { Why::WithinTolerance { sum } };
    }
}

/// The scene without some of its effects, and without a requirement.
fn without(scene: &Scene, off: impl Fn(&str) -> bool) -> Scene {
    let mut scene = Scene { asked: None, switches: Switches::default(), ..scene.clone() };
    scene.effects.remove(&off);
    Optics::ALL.into_iter().filter(|effect| off(effect.name())).for_each(|effect| effect.remove(&mut scene));
    scene
}

impl core::fmt::Display for Plan {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let unit = self.asked.map_or("px", |asked| asked.unit());
        match &self.asked {
            Some(asked) => writeln!(f, "asked: {asked}")?,
            None => writeln!(f, "asked: nothing, so every effect that is listed is on")?,
        }
        writeln!(f, "{:16}  {:>12}  {:3}  {:>9}  why", "effect", "bound", "on", "cost")?;
        for entry in &self.entries {
            let bound = self.asked.map_or(entry.bound.px, |asked| asked.of(&entry.bound));
            let on = if entry.on { "on" } else { "off" };
            let cost_us = if entry.on { 1e-3 * entry.cost_ns } else { 0.0 };
            let Entry { effect, why, .. } = entry;
            writeln!(f, "{effect:16}  {:>12}  {on:3}  {cost_us:6.0} us  {why}", Shown(bound, unit))?;
        }
        Ok(())
    }
}

/// A number with its unit, to three digits.
struct Shown(f64, &'static str);

impl core::fmt::Display for Shown {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let &Self(value, unit) = self;
        let text = match value {
            0.0 => String::from("0"),
            _ if !value.is_finite() => String::from("any"),
            _ if value.abs() >= 100.0 => format!("{value:.0}"),
            _ if value.abs() >= 0.1 => format!("{value:.2}"),
            _ if value.abs() >= 1e-4 => format!("{value:.5}"),
            _ => format!("{value:.1e}"),
        };
        let text = if unit.is_empty() { text } else { format!("{text} {unit}") };
        f.pad(&text)
    }
}

impl core::fmt::Display for Asked {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let what = match self {
            Self::Positions { .. } => "positions",
            Self::Points { .. } => "points",
            Self::Images { .. } => "images",
        };
        write!(f, "{what} within {} {}", self.tolerance(), self.unit())
    }
}

impl core::fmt::Display for Why {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NothingAsked => f.write_str("nothing is asked"),
            Self::Switched => f.write_str("the scene says so"),
            Self::WithinTolerance { sum } => {
                write!(f, "off, at most {} is missing: within the tolerance", Shown(*sum, ""))
            }
            Self::BeyondTolerance { sum } => write!(f, "without it {} could be missing", Shown(*sum, "")),
        }
    }
}

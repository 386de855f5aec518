//! Frames of every preset, rung and simulated sensor.

use crate::sensor::{Pair, press, scene, sense, sense_afresh};
use crate::{Digests, Outcome};
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use gelstereo_core::digest::Digest;
use gelstereo_core::params::{
    Background, Centre, DiscBias, FindAt, ForceMethod, ForceParams, LabelMethod, Motion, Params, Polarity,
    PrintLayout, Saliency, Search, SlipMethod, Threshold, TriangulateMethod,
};
use gelstereo_core::pipeline::Pipeline;
use gelstereo_sim::{Gel, Scene};

/// The settings of a preset.
pub fn preset(name: &str) -> Outcome<Params> {
    Ok(Params::preset(name).ok_or("no such preset")?)
}

pub fn presets(out: &mut Digests) -> Outcome<()> {
    let scene = scene();
    let pairs = press(&scene)?;
    let images = pairs.iter().fold(Digest::new(), |digest, pair| pair.digest(digest));
    out.push(("preset/images".into(), images.value()));
    for name in Params::PRESETS {
        let digest = sense_afresh(&scene, &pairs, &preset(name)?)?;
        out.push((format!("preset/{name}"), digest.value()));
    }
    Ok(())
}

/// All variants of a ladder. One that is missing here does not compile.
macro_rules! every {
    ($ladder:ident: $($rung:ident)*) => {{
        let _ = |rung: $ladder| match rung { $($ladder::$rung => {})* };
        [$($ladder::$rung),*]
    }};
}
pub(crate) use every;

/// `balanced` with one setting changed at a time, to each of its values.
pub fn rungs(out: &mut Digests) -> Outcome<()> {
    let dark = scene();
    let bright = Scene { gel: Gel { bright_dots: true, ..dark.gel.clone() }, ..dark.clone() };
    let of_dark = press(&dark)?;
    let of_bright = press(&bright)?;
    let balanced = preset("balanced")?;
    let mut add = |name: String, pairs: &[Pair], change: &dyn Fn(&mut Params)| -> Outcome<()> {
        let mut params = balanced.clone();
        change(&mut params);
        let digest = sense_afresh(&dark, pairs, &params).map_err(|error| format!("{name}: {error}"))?;
        out.push((format!("rung/{name}"), digest.value()));
        Ok(())
    };
    for rung in every!(Polarity: Dark Bright) {
        let pairs = if rung == Polarity::Dark { &of_dark } else { &of_bright };
        add(format!("polarity/{rung:?}"), pairs, &|params| params.detect.polarity = rung)?;
    }
    for rung in every!(Background: Gaussian Blocks) {
        add(format!("background/{rung:?}"), &of_dark, &|params| params.detect.background = rung)?;
    }
    for rung in every!(Threshold: Fixed Auto) {
        add(format!("threshold/{rung:?}"), &of_dark, &|params| params.detect.threshold = rung)?;
    }
    for rung in every!(Centre: Binary Grey SoftThreshold Fit) {
        add(format!("centre/{rung:?}"), &of_dark, &|params| params.detect.centre = rung)?;
    }
    for rung in every!(Search: Whole Windows) {
        add(format!("search/{rung:?}"), &of_dark, &|params| params.detect.search = rung)?;
    }
    for rung in every!(FindAt: FullSize HalfSize) {
        add(format!("find_at/{rung:?}"), &of_dark, &|params| {
            params.detect.centre = Centre::SoftThreshold;
            params.detect.find_at = rung;
        })?;
    }
    for rung in every!(LabelMethod: Foresight Lattice) {
        add(format!("label/{rung:?}"), &of_dark, &|params| params.label.method = rung)?;
    }
    for rung in every!(Motion: Still ConstantVelocity) {
        add(format!("motion/{rung:?}"), &of_dark, &|params| params.track.motion = rung)?;
    }
    for rung in every!(TriangulateMethod: Q Polynomial Rays) {
        add(format!("triangulate/{rung:?}"), &of_dark, &|params| params.triangulate.method = rung)?;
    }
    for rung in every!(DiscBias: Ignored Corrected) {
        add(format!("disc_bias/{rung:?}"), &of_dark, &|params| params.triangulate.disc_bias = rung)?;
    }
    for rung in every!(Saliency: Depth Pressure Adaptive) {
        add(format!("saliency/{rung:?}"), &of_dark, &|params| params.contact.saliency = rung)?;
    }
    for rung in every!(ForceMethod: None Resultant Ridge Bounded) {
        add(format!("force/{rung:?}"), &of_dark, &|params| {
            let (thickness_mm, young_kpa) = (Some(5.0), Some(100.0));
            params.force = ForceParams {
                method: rung,
                thickness_mm,
                young_kpa,
                friction: Some(0.5),
                patch_n_per_mm3: Some(0.03),
                around_n_per_mm3: Some(0.04),
                shear_n_per_mm3: Some(0.01),
                ..Default::default()
            };
        })?;
    }
    for rung in every!(SlipMethod: None Rigid) {
        add(format!("slip/{rung:?}"), &of_dark, &|params| params.slip.method = rung)?;
    }
    let gel = Gel { layout: PrintLayout::Hexagonal, rows: 12, cols: 10, ..dark.gel.clone() };
    let of_hexagonal = press(&Scene { gel, ..dark.clone() })?;
    for rung in every!(Saliency: Depth Pressure Adaptive) {
        add(format!("hexagonal/{rung:?}"), &of_hexagonal, &|params| {
            params.lattice.layout = PrintLayout::Hexagonal;
            params.contact.saliency = rung;
            params.detect.search = Search::Windows;
            params.slip.method = SlipMethod::Rigid;
            let (thickness_mm, young_kpa) = (Some(5.0), Some(100.0));
            params.force =
                ForceParams { method: ForceMethod::Bounded, thickness_mm, young_kpa, ..Default::default() };
        })?;
    }
    add("learn_decay".into(), &of_dark, &|params| {
        params.contact.saliency = Saliency::Pressure;
        params.contact.learn_decay = true;
    })
}

/// Images kept and sensed again after another past, and from a record of the rest state.
pub fn replays(out: &mut Digests) -> Outcome<()> {
    let scene = scene();
    let pairs = press(&scene)?;
    for name in Params::PRESETS {
        let params = preset(name)?;
        let mut pipeline = Pipeline::new(&scene.rig, &params)?;
        let first = sense(&pairs, &mut pipeline, Digest::new())?;
        let record = pipeline.rest_record().ok_or("no rest state")?;
        pipeline.reset();
        let again = sense(&pairs, &mut pipeline, Digest::new())?;
        if again != first {
            return Err(format!("{name}: images that are sensed again give other bits").into());
        }
        out.push((format!("replay/{name}/again"), again.value()));
        pipeline.resume(&record)?;
        let resumed = sense(&pairs, &mut pipeline, Digest::new())?;
        out.push((format!("replay/{name}/resumed"), resumed.value()));
    }
    Ok(())
}

/// Two frames of every simulated sensor, by the preset `balanced`.
pub fn sensors(out: &mut Digests) -> Outcome<()> {
    for name in Scene::PRESETS {
        let bare = Scene::preset(name).ok_or("no such sensor")?;
        let Scene { effects, indenter, .. } = scene();
        let scene = Scene { effects, indenter, ..bare };
        let mut params = preset("balanced")?;
        params.lattice.pitch_mm = scene.gel.pitch_mm;
        let mut sensor = crate::sensor::Sensor::new(&scene, &crate::part::wedge()?)?;
        let pairs = [0.0, 0.7].map(|press_mm| sensor.press(press_mm, 0.0).map(|(pair, _)| pair));
        let pairs = pairs.into_iter().collect::<Outcome<Vec<Pair>>>()?;
        let digest = pairs.iter().fold(Digest::new(), |digest, pair| pair.digest(digest));
        let digest = sense(&pairs, &mut Pipeline::new(&scene.rig, &params)?, digest)
            .map_err(|error| format!("{name}: {error}"))?;
        out.push((format!("sensor/{name}"), digest.value()));
    }
    Ok(())
}

//! The last left image of a stage, with markers and their motion.

use crate::report::Stage;
use crate::report::trace::{Markers, Picture, Sensed};
use crate::source::Gray;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use gelstereo_core::math::DVec2;
use gelstereo_core::track::MarkerState;
use gelstereo_png::PngEncoder;
use maud::{Markup, html};
use std::fmt::Write;

/// Radius of a ring relative to the marker pitch; rings must not touch.
const RING_SHARE: f64 = 0.42;
/// Shortest motion drawn as an arrow.
const MIN_ARROW_PX: f64 = 1.5;

/// The picture, with its caption and a legend.
pub(super) fn figure(stage: Stage, picture: &Picture) -> Markup {
    let Gray { width, height, .. } = picture.left;
    let caption = caption(stage, &picture.sensed);
    html! {
        figure {
            svg role="img" aria-label=(caption) viewBox={ "0 0 " (width) " " (height) } {
                title { (caption) }
                image width=(width) height=(height) href=(data_url(&picture.left)) {}
                @if let Sensed::Markers(markers) = &picture.sensed { (overlay(markers)) }
            }
            figcaption { (caption) }
            @if let Sensed::Markers(markers) = &picture.sensed { (legend(markers)) }
        }
    }
}

fn caption(stage: Stage, sensed: &Sensed) -> String {
    let name = stage.name();
    match sensed {
        Sensed::Nothing => format!("{name}: left image; the frames of this stage are not sensed"),
        Sensed::Bad(reason) => format!("{name}: left image, which could not be sensed: {reason}"),
        Sensed::Markers(markers) => {
            let motion_px = markers.motion_px;
            format!("{name}: left image with its markers; they moved by {motion_px:.2} px in the mean")
        }
    }
}

fn data_url(image: &Gray) -> String {
    let mut file = Vec::new();
    PngEncoder::default().encode(&image.pixels, image.width, &mut file);
    format!("data:image/png;base64,{}", STANDARD.encode(file))
}

/// Meaning of a ring.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ring {
    Seen,
    Held,
    Lost,
    Salient,
}

impl Ring {
    const ALL: [Self; 4] = [Self::Seen, Self::Held, Self::Lost, Self::Salient];

    const fn name(self) -> &'static str {
        match self {
            Self::Seen => "seen",
            Self::Held => "held",
            Self::Lost => "lost",
            Self::Salient => "salient",
        }
    }

    fn of(markers: &Markers, index: usize) -> Self {
        match (markers.salient.get(index), markers.state.get(index)) {
            (Some(true), _) => Self::Salient,
            (_, Some(MarkerState::Seen)) => Self::Seen,
            (_, Some(MarkerState::Held)) => Self::Held,
            _ => Self::Lost,
        }
    }
}

/// Rings around the markers and arrows along their motion.
fn overlay(markers: &Markers) -> Markup {
    let radius = RING_SHARE * pitch_px(markers);
    // Pixel centres have integer coordinates; SVG has pixel corners there.
    let place = |p: &DVec2| *p + DVec2::splat(0.5);
    let rings = Ring::ALL.map(|ring| {
        let mut path = String::new();
        for (index, now) in markers.now_px.iter().enumerate() {
            if Ring::of(markers, index) == ring && now.is_finite() {
                push_ring(&mut path, place(now), radius);
            }
        }
        path
    });
    let mut arrows = String::new();
    for (from, to) in markers.reference_px.iter().zip(&markers.now_px) {
        push_arrow(&mut arrows, place(from), place(to));
    }
    html! {
        g class="markers" {
            @for (ring, path) in Ring::ALL.iter().zip(&rings) {
                @if !path.is_empty() { path class=(ring.name()) d=(path) {} }
            }
            @if !arrows.is_empty() { path class="motion" d=(arrows) {} }
        }
    }
}

fn legend(markers: &Markers) -> Markup {
    let count =
        |ring: Ring| (0..markers.now_px.len()).filter(|&index| Ring::of(markers, index) == ring).count();
    html! {
        p class="legend" {
            @for ring in Ring::ALL {
                span { span class={ "key " (ring.name()) } {} (count(ring)) " " (ring.name()) }
            }
            span { "white: motion since the reference" }
        }
    }
}

/// Mean distance between neighbours in a row.
fn pitch_px(markers: &Markers) -> f64 {
    let gaps = markers.now_px.chunks(markers.cols.max(1)).take(markers.rows).flat_map(|row| row.windows(2));
    let (sum, count) = gaps
        .map(|two| two[0].distance(two[1]))
        .filter(|gap| gap.is_finite())
        .fold((0.0, 0), |(sum, count), gap| (sum + gap, count + 1));
    if count == 0 { 0.0 } else { sum / f64::from(count) }
}

fn push_ring(path: &mut String, centre: DVec2, radius: f64) {
    let (left, diameter) = (centre.x - radius, 2.0 * radius);
    // Two half circles. Writing to a string cannot fail.
    let _ = write!(path, "M{left:.1} {:.1}", centre.y);
    for across in [diameter, -diameter] {
        let _ = write!(path, "a{radius:.1} {radius:.1} 0 1 0 {across:.1} 0");
    }
}

fn push_arrow(path: &mut String, from: DVec2, to: DVec2) {
    let along = to - from;
    let length = along.length();
    if !length.is_finite() || length < MIN_ARROW_PX {
        return;
    }
    let head = along / length * length.min(8.0) * 0.5;
    let side = head.perp() * 0.5;
    let (one, other) = (to - head + side, to - head - side);
    let _ = write!(
        path,
        "M{:.1} {:.1}L{:.1} {:.1}M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}",
        from.x, from.y, to.x, to.y, one.x, one.y, to.x, to.y, other.x, other.y
    );
}

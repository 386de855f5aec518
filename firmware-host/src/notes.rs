//! Text notes on frames and stages in a recording. A replay regenerates the notes and compares them
//! character by character; the digests in them represent all bits of a result.

use crate::report::Stage;
use crate::sensing::{Action, Sensing, SensingError};
use gelstereo_core::register::{Registration, TrackingStatus};
use gelstereo_core::slip::Slip;
use gelstereo_core::track::MarkerState;

/// Note for the topic `/gelstereo/slip`: how the contact slips, and how much of it sticks.
#[must_use]
pub fn slip_note(slip: &Slip) -> serde_json::Value {
    let mut note = serde_json::json!({
        "status": slip.status,
        "stick_ratio": slip.stick_ratio,
        "stick_range": slip.stick_range,
    });
    if let Some(margin) = &slip.margin {
        note["margin"] = serde_json::json!(margin);
    }
    note
}

/// Note for the topic `/gelstereo/frame`: figures and digest of a frame, or the error; with a deadline also
/// the limit of work and whether a cheaper method was used.
#[must_use]
pub fn frame_note(sensed: &Result<(), SensingError>, sensing: &Sensing) -> serde_json::Value {
    let mut note = match sensed {
        Err(error) => serde_json::json!({ "error": error.to_string() }),
        Ok(()) => {
            let frame = sensing.frame();
            serde_json::json!({
                "index": frame.index,
                "motion_px": frame.motion_px,
                "seen": frame.state.iter().filter(|&&state| state == MarkerState::Seen).count(),
                "salient": frame.salient.iter().filter(|&&salient| salient).count(),
                "detected": [frame.left.detected, frame.right.detected],
                "mismatched": frame.mismatched,
                "digest": format!("{:016x}", frame.digest()),
            })
        }
    };
    if let Some(limit) = sensing.work_limit() {
        // A replay uses it instead of a clock.
        note["work_limit"] = limit.into();
        note["degraded"] = (sensing.frame().left.is_degraded || sensing.frame().right.is_degraded).into();
    }
    note
}

/// Name of a tracking status in notes and lines.
#[must_use]
pub const fn tracking_name(tracking: TrackingStatus) -> &'static str {
    match tracking {
        TrackingStatus::Tracking => "tracking",
        TrackingStatus::Relocalized => "relocalized",
        TrackingStatus::Lost => "lost",
    }
}

/// Note for the topic `/gelstereo/stage`: an action and its result, and the tracking status of a tracked
/// part.
#[must_use]
pub fn action_note(
    stage: Stage,
    action: &Action,
    result: &Result<Option<Registration>, SensingError>,
    tracking: Option<TrackingStatus>,
) -> serde_json::Value {
    let mut note = serde_json::json!({ "stage": stage, "request": action });
    match result {
        Ok(Some(found)) => {
            note["digest"] = format!("{:016x}", found.digest()).into();
            note["converged"] = found.converged.into();
            note["free"] = found.free.iter().map(ToString::to_string).collect::<Vec<_>>().into();
            if let (Action::Follow, Some(tracking)) = (action, tracking) {
                note["tracking"] = tracking_name(tracking).into();
            }
        }
        Ok(None) => {}
        Err(error) => note["error"] = error.to_string().into(),
    }
    note
}

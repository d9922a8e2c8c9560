//! What nodes log about their inputs.

use wm_ros::complaints::Complaints;

use super::{Arrival, HistoryError};

/// Counts and reports what became of an input.
pub(crate) fn note(complaints: &mut Complaints, arrival: Result<Arrival, HistoryError>) {
    let arrival = match arrival {
        Ok(arrival) => arrival,
        Err(error) => {
            complaints.left_out(error.reason(), &error);
            return;
        }
    };
    match arrival.camera_step {
        Some(step) => tracing::error!("starting a new history: {step}"),
        None if arrival.flushed => tracing::info!(
            "starting a new history: time jumped, or the camera or the encoder changed"
        ),
        None => {}
    }
    if arrival.untimely > 0 {
        let text =
            "stamps are far from those of the frames, and no second frame confirms a clock jump";
        complaints.left_out_many("untimely", arrival.untimely, &text);
    }
    if let Some(late) = arrival.late_chunk {
        complaints.left_out("untimely_action", &late);
    }
    if arrival.missed_frames > 0 {
        let text = format!("{} camera frames are missing", arrival.missed_frames);
        complaints.left_out_many("gap", arrival.missed_frames, &text);
    }
}

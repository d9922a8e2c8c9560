//! Checks of the cameras, actions and states of a recording.

use crate::{
    Clocks, Finding, Pictures, Stamps,
    episode::{Effect, Strength, differences},
};
use wm_camera::signature::Signature;
use wm_motion::actions::ActionSpace;

/// Actions older than this do not count at a time \[ns\].
const NEAR_NS: i64 = 1_000_000_000;

/// A camera of a recording.
#[derive(Clone, Debug)]
pub struct RecordedCamera {
    /// Times of its messages.
    pub clocks: Clocks,
    /// Its pictures.
    pub pictures: Pictures,
}

/// The cameras and actions of a recording.
#[derive(Clone, Debug)]
pub struct RecordedTopics {
    /// The cameras; the first is compared with actions.
    pub cameras: Vec<RecordedCamera>,
    /// Times of the actions.
    pub actions: Clocks,
    /// Times of the messages of each state topic.
    pub states: Vec<Clocks>,
}

impl RecordedTopics {
    /// Topics without messages.
    #[must_use]
    pub fn new<'a>(cameras: impl IntoIterator<Item = &'a str>, action_topic: &str) -> Self {
        let camera = |topic| RecordedCamera {
            clocks: Clocks::new(topic),
            pictures: Pictures::new(topic),
        };
        Self {
            cameras: cameras.into_iter().map(camera).collect(),
            actions: Clocks::new(action_topic),
            states: Vec::new(),
        }
    }

    /// Adds the times of a state message.
    pub fn state(&mut self, topic: &str, stamps: Stamps) {
        if let Some(clocks) = self.states.iter_mut().find(|clocks| clocks.topic == topic) {
            return clocks.push(stamps);
        }
        let mut clocks = Clocks::new(topic);
        clocks.push(stamps);
        self.states.push(clocks);
    }

    /// Adds the times of a message of camera `camera`.
    pub fn stamp(&mut self, camera: usize, stamps: Stamps) {
        if let Some(camera) = self.cameras.get_mut(camera) {
            camera.clocks.push(stamps);
        }
    }

    /// Adds a picture of camera `camera`: time of capture \[ns\], fingerprint, width and height \[px\], and signature if it was
    /// decoded. Returns the mean change since the previous picture \[levels\], if both have a signature.
    pub fn picture(
        &mut self,
        camera: usize,
        (stamps, at_ns): (Stamps, i64),
        (fingerprint, size): (u64, Option<(u32, u32)>),
        signature: Option<Signature>,
    ) -> Option<f32> {
        let camera = self.cameras.get_mut(camera)?;
        camera.clocks.push(stamps);
        camera.pictures.push(at_ns, fingerprint, size, signature)
    }

    /// Checks the stamps. If `uses_headers` is false, other times are used, and unusable headers get a note.
    #[must_use]
    pub fn check_stamps(&self, uses_headers: bool) -> Vec<Finding> {
        let clocks = self.cameras.iter().map(|camera| &camera.clocks);
        let mut findings: Vec<Finding> = clocks
            .chain([&self.actions])
            .flat_map(Clocks::check)
            .collect();
        let pairs = self.cameras.iter();
        findings
            .extend(pairs.filter_map(|camera| Clocks::check_pair(&camera.clocks, &self.actions)));
        findings.extend(self.states.iter().filter_map(Clocks::check_gaps));
        if !uses_headers {
            for finding in findings.iter_mut().filter(|finding| finding.is_fault()) {
                finding.level = crate::Level::Note;
                finding.fix = Some("nothing: --stamps chose other times".to_owned());
            }
        }
        findings
    }

    /// Checks that the first camera is fast enough for the actions.
    #[must_use]
    pub fn check_rate(&self, space: &ActionSpace) -> Option<Finding> {
        let own = 1.0 / self.cameras.first()?.clocks.gaps().median_s()?;
        if space.is_fast_enough(own) {
            return None;
        }
        let what = format!(
            "the camera has {own:.1} frames per second, but the actions are of {} Hz",
            space.rate()
        );
        let finding = Finding::warning("rate", what)
            .because(
                "a training treats its frames as one action apart; live, the predictor waits for frames in between and \
                 predicts nothing",
            )
            .fix(format!("give the action space the camera's rate: \"rate\": {own:.2} (--action-space)"));
        Some(finding.figure("camera_hz", own))
    }

    /// Checks the pictures.
    #[must_use]
    pub fn check_pictures(&self, actions: &ActionTrack) -> Vec<Finding> {
        let cameras = self.cameras.iter();
        cameras
            .flat_map(|camera| actions.check_pictures(&camera.pictures))
            .collect()
    }
}

/// The activity of a robot over time.
#[derive(Clone, Debug, Default)]
pub struct ActionTrack {
    /// Stamp \[ns\] and activity, in the order of the stamps.
    actions: Vec<(i64, f32)>,
}

impl ActionTrack {
    /// Computes it from actions in the order of their stamps \[ns\].
    #[must_use]
    pub fn new<'a>(
        space: &ActionSpace,
        rows: impl Iterator<Item = (i64, &'a [f32])> + Clone,
    ) -> Self {
        let dimensions = space.dimensions().iter().enumerate();
        let columns: Vec<Vec<f32>> = dimensions
            .map(|(index, dimension)| {
                let values = rows
                    .clone()
                    // In range: callers have checked the rows against `space`.
                    .map(|(_, row)| row.get(index).copied().unwrap_or(0.0));
                let values: Vec<f32> = values.collect();
                match Effect::of(dimension.kind) {
                    Effect::Change => values,
                    Effect::Target => differences(&values),
                    Effect::Gripper => vec![0.0; values.len()],
                }
            })
            .collect();
        let strength = Strength::of(columns.iter().cloned());
        let activity = |at: usize| {
            let row = columns
                .iter()
                // In range: each column has one value per row.
                .map(|column| column.get(at).copied().unwrap_or(0.0));
            strength.activity(row)
        };
        let stamps = rows.map(|(at_ns, _)| at_ns).enumerate();
        Self {
            actions: stamps.map(|(at, at_ns)| (at_ns, activity(at))).collect(),
        }
    }

    /// Whether it has no actions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    /// Checks the pictures of a camera that shows the robot.
    #[must_use]
    pub fn check_pictures(&self, pictures: &Pictures) -> Vec<Finding> {
        let activity = |from_ns, to_ns| self.activity(from_ns, to_ns);
        let known: Option<crate::pictures::Activity<'_>> = (!self.is_empty()).then_some(&activity);
        pictures.check(known)
    }

    /// The largest activity between two times \[ns\].
    #[must_use]
    pub fn activity(&self, from_ns: i64, to_ns: i64) -> Option<f32> {
        // The action in effect at the start, and the later ones.
        let first = self.actions.partition_point(|(at_ns, _)| *at_ns <= from_ns);
        let end = self.actions.partition_point(|(at_ns, _)| *at_ns < to_ns);
        let first = first.saturating_sub(1);
        let acting = self.actions.get(first..end.max(first + 1))?;
        let is_near =
            |(at_ns, _): &&(i64, f32)| *at_ns < to_ns && from_ns.saturating_sub(*at_ns) <= NEAR_NS;
        let acting = acting.iter().filter(is_near).map(|(_, acts)| *acts);
        acting.reduce(f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn action_in_effect_counts() {
        let strong = [0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let idle = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let rows = [(0, &idle), (200, &strong), (400, &idle)];
        let rows = rows.map(|(at, row)| (at * 1_000_000, row.as_slice()));
        let track = ActionTrack::new(&ActionSpace::bridge(), rows.into_iter());
        let activity = |from: i64, to: i64| track.activity(from * 1_000_000, to * 1_000_000);
        assert_eq!(activity(0, 200), Some(0.0));
        assert_eq!(activity(200, 400), Some(1.0));
        assert_eq!(activity(100, 300), Some(1.0));
        assert_eq!(activity(400, 600), Some(0.0));
        assert_eq!(activity(2_000, 2_200), None);
        assert_eq!(activity(-400, -200), None);
    }
}

//! Remedies for values that contradict their kinds or look unusual.

use wm_motion::actions::{ActionSurvey, Cause, Contradiction, Hint, Kind, Range};

use crate::GripperRange;

/// Tolerance at the ends of a gripper's range, as a share of the range.
const REACH: f32 = 0.1;

/// Origin of the measured values in the data set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ValueSource {
    /// The applied mapping of the gripper.
    pub gripper: Option<GripperRange>,
    /// Whether an action is the motion between two recorded states.
    pub is_of_states: bool,
}

impl ValueSource {
    /// The option that maps these openings to closed and open, and the swapped option.
    fn gripper_options(self, closed: f32, open: f32) -> (String, String) {
        let value = |opening: f32| {
            let opening = f64::from(opening);
            let value = self.gripper.map_or(opening, |range| range.value(opening));
            let rounded = (value * 1e4).round() / 1e4;
            // Avoids "-0".
            if rounded == 0.0 { 0.0 } else { rounded }
        };
        let (closed, open) = (value(closed), value(open));
        let option = |closed, open| format!("--gripper-range {closed}:{open}");
        (option(closed, open), option(open, closed))
    }

    /// Describes a contradiction and the option that maps the values.
    #[must_use]
    pub fn remedy(self, found: &Contradiction) -> String {
        let is_hand = matches!(found.kind, Kind::TranslationDelta | Kind::RotationDelta);
        let is_angle = found.unit.starts_with("rad");
        let option = match found.cause {
            Cause::Gripper { closed, open } => {
                // Mapped values do not prove the original range.
                let measured = (found.measured.low, found.measured.high);
                let (closed, open) = self.gripper.map_or((closed, open), |_| measured);
                let (option, exchanged) = self.gripper_options(closed, open);
                format!("map them with {option}, or {exchanged} if it closes the other way")
            }
            Cause::Millimetres if is_hand => "map them with --translation-scale 0.001".to_owned(),
            Cause::Millimetres => "set the unit mm (or mm/s) in --action-space FILE".to_owned(),
            Cause::Degrees if is_hand => "map them with --rotation-scale 0.0174533".to_owned(),
            Cause::Degrees => "set the unit deg (or deg/s) in --action-space FILE".to_owned(),
            _ if self.is_of_states && is_hand => {
                "an action is the motion from one recorded state to the next: repair the states, or remove the episode"
                    .to_owned()
            }
            Cause::Absolute if is_hand => "map them with --actions absolute".to_owned(),
            Cause::Absolute => "describe them as joint_position in --action-space FILE".to_owned(),
            Cause::Normalised if is_hand && is_angle => {
                "map them with --rotation-scale RAD, the angle for a value of 1, or with --actions velocity".to_owned()
            }
            Cause::Normalised if is_hand => {
                "map them with --translation-scale METRES, the distance for a value of 1, or with --actions velocity".to_owned()
            }
            Cause::TooFar if is_hand => return found.to_string(),
            Cause::Normalised | Cause::TooFar => {
                "set the kind and the unit in --action-space FILE, or repair the data".to_owned()
            }
        };
        format!("{found}; {option}")
    }

    /// Describes a hint and the option that maps the values.
    #[must_use]
    pub fn advice(self, hint: &Hint) -> String {
        match hint {
            Hint::GripperRange { measured, .. } => {
                let (option, exchanged) = self.gripper_options(measured.low, measured.high);
                format!(
                    "{hint}; if these are its ends, map them with {option}, or {exchanged} if it closes the other way"
                )
            }
            Hint::GripperInverted { measured, .. } | Hint::GripperOpposed { measured } => {
                let (closed, open) = ends(*measured);
                let (_, exchanged) = self.gripper_options(closed, open);
                format!("{hint}; if so, map it with {exchanged}")
            }
            Hint::Scale { column, .. } => {
                let turns = ["droll", "dpitch", "dyaw"];
                let option = match turns.contains(&column.as_str()) {
                    true => "--rotation-scale",
                    false => "--translation-scale",
                };
                format!("{hint}; if so, map it with --actions velocity, or with {option}")
            }
            _ => hint.to_string(),
        }
    }

    /// Describes the first contradiction of an episode or a data set, if any.
    #[must_use]
    pub fn contradiction(self, survey: &ActionSurvey) -> Option<String> {
        let found = survey.contradictions();
        let first = self.remedy(found.first()?);
        let is_unit = |found: &Contradiction| {
            self.is_of_states && !matches!(found.cause, Cause::Gripper { .. })
        };
        // A jump in one episode does not prove another unit.
        let unit = match survey.episodes() > 1 && found.first().is_some_and(is_unit) {
            true => {
                "; if they are not in m and rad, set their unit with --translation-scale or --rotation-scale"
            }
            false => "",
        };
        Some(match found.len() {
            1 => format!("{first}{unit}"),
            count => format!("{first}{unit} (and {} more of its values)", count - 1),
        })
    }
}

/// The openings of closed and open: 0 and 1 if they are reached, otherwise the measured ones.
fn ends(measured: Range) -> (f32, f32) {
    match measured.low < REACH && measured.high > 1.0 - REACH {
        true => (0.0, 1.0),
        false => (measured.low, measured.high),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The remark on a gripper with these openings in each of two episodes.
    fn remark(source: ValueSource, openings: [f32; 2]) -> String {
        let space = wm_motion::actions::ActionSpace::bridge();
        let mut survey = ActionSurvey::new(space, 5.0);
        for _ in 0..2 {
            let [first, last] = openings;
            let row = |gripper| [0.001, 0.0, 0.0, 0.0, 0.0, 0.0, gripper];
            let none: &[[f32; 7]] = &[];
            survey.add(&[first, first, first, last, last, last].map(row), none);
        }
        let hints = survey.hints();
        let mut lines: Vec<String> = hints.iter().map(|hint| source.advice(hint)).collect();
        lines.extend(source.contradiction(&survey));
        lines.join("\n")
    }

    fn mapped(text: &str) -> ValueSource {
        ValueSource {
            gripper: Some(text.parse().unwrap()),
            is_of_states: false,
        }
    }

    #[test]
    fn gripper_remarks_name_the_range_and_the_option() {
        let plain = ValueSource::default();
        for (openings, expected) in [
            (
                [0.8, 0.0],
                "measured 0 to 0.8; never reaches both closed (0) and open (1); if these are its ends, map \
                          them with --gripper-range 0:0.8, or 0.8:0",
            ),
            (
                [0.0, 1.0],
                "measured 0 to 1; 2 of 2 episodes begin with a closed gripper; in this data set, 0 may mean \
                          open; if so, map it with --gripper-range 1:0",
            ),
            ([0.0, 0.8], "if so, map it with --gripper-range 0.8:0"),
            (
                [1.0, -1.0],
                "measured -1 to 1; expected 0 (closed) to 1 (open); map them with --gripper-range -1:1, or \
                           1:-1",
            ),
            (
                [100.0, 0.0],
                "measured 0 to 100; expected 0 (closed) to 1 (open); map them with --gripper-range 0:100",
            ),
        ] {
            let found = remark(plain, openings).replace("or --gripper-range ", "or ");
            assert!(found.contains(expected), "{openings:?}: {found}");
        }
        assert_eq!(remark(plain, [1.0, 0.0]), "");
    }

    #[test]
    fn option_has_values_of_the_data_set() {
        // 0 open to 0.8 closed, imported as DROID's 0 to 1.
        let found = remark(mapped("1:0"), [1.0, 0.2]);
        assert!(found.contains("with --gripper-range 0.8:0"), "{found}");
        let found = remark(mapped("1:0"), [0.0, 1.0]);
        assert!(
            found.contains("if so, map it with --gripper-range 0:1"),
            "{found}"
        );
        // 0 to 100, mapped as 0 to 50.
        let found = remark(mapped("0:50"), [2.0, 0.0]);
        assert!(
            found.contains("map them with --gripper-range 0:100"),
            "{found}"
        );
    }

    #[test]
    fn jumps_of_states_need_repair_not_mapping() {
        let source = ValueSource {
            gripper: None,
            is_of_states: true,
        };
        let survey = |episodes: usize| {
            let space = wm_motion::actions::ActionSpace::bridge();
            let mut survey = ActionSurvey::new(space, 5.0);
            for _ in 0..episodes {
                let mut actions = [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]; 6];
                actions[2][0] = 0.7;
                survey.add(&actions, &[] as &[[f32; 7]]);
            }
            survey
        };
        let one = source.contradiction(&survey(1)).unwrap();
        assert!(
            one.contains("repair the states, or remove the episode"),
            "{one}"
        );
        assert!(
            !one.contains("-scale") && !one.contains("--actions"),
            "{one}"
        );
        let all = source.contradiction(&survey(3)).unwrap();
        assert!(
            all.contains("set their unit with --translation-scale"),
            "{all}"
        );
        let plain = ValueSource::default().contradiction(&survey(1)).unwrap();
        assert!(plain.contains("--translation-scale METRES"), "{plain}");
    }
}

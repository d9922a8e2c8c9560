//! A plan as shapes for viewers.

use std::time::Duration;

use wm_motion::actions::{ActionSpace, Kind};
use wm_msgs::{visualization_msgs::MarkerArray, wm_msgs::Plan};
use wm_wire::marker::{Position, Style, ball, path};

/// Blue, which tells it from what the robot and its workspace are drawn in.
const COLOR: [f32; 4] = [0.2, 0.5, 1.0, 1.0];
/// Of the ball at its end \[m\].
const END_RADIUS_M: f64 = 0.008;

/// The way of the end effector by `plan`, which finds it at `begin` in the frame of the actions, and a ball where that
/// ends; they vanish when the plan is over. None where its actions do not say where the end effector goes in a frame with
/// a name.
pub(super) fn markers(plan: &Plan, begin: Position, space: &ActionSpace) -> Option<MarkerArray> {
    let header = plan.actions.first().map(|action| &action.header)?;
    let positions = positions(plan, begin, space)?;
    let end = *positions.last()?;
    if header.frame_id.is_empty() {
        return None;
    }
    let steps = usize::try_from(plan.lead_steps).ok()? + plan.actions.len();
    let period = Duration::from_nanos(plan.period.to_nanos().unsigned_abs());
    let style = Style {
        ns: "plan",
        color: COLOR,
        // A handful.
        lifetime: period * u32::try_from(steps).ok()?,
    };
    let way = path(header.clone(), &style, &positions);
    let mut end = ball(header.clone(), &style, end, END_RADIUS_M);
    end.id = 1;
    Some(MarkerArray {
        markers: vec![way, end],
    })
}

/// Where the end effector is before the first action, and after each.
fn positions(plan: &Plan, begin: Position, space: &ActionSpace) -> Option<Vec<Position>> {
    let of_kind = |kind: Kind| {
        let dimensions = space.dimensions().iter().enumerate();
        let indices: Vec<usize> = dimensions
            .filter(|(_, dimension)| dimension.kind == kind)
            .map(|(index, _)| index)
            .collect();
        <[usize; 3]>::try_from(indices).ok()
    };
    let (axes, is_delta) = match (of_kind(Kind::TranslationDelta), of_kind(Kind::Position)) {
        (Some(axes), _) => (axes, true),
        (None, Some(axes)) => (axes, false),
        (None, None) => return None,
    };
    let mut at = begin;
    let mut positions = vec![at];
    for action in &plan.actions {
        for (slot, index) in at.iter_mut().zip(axes) {
            let value = f64::from(*action.values.get(index)?);
            *slot = if is_delta { *slot + value } else { value };
        }
        positions.push(at);
    }
    Some(positions)
}

#[cfg(test)]
mod tests {
    use wm_msgs::{
        builtin_interfaces::Duration, std_msgs::Header, visualization_msgs::Marker, wm_msgs::Action,
    };

    use super::*;

    fn plan(values: &[&[f32]], frame_id: &str) -> Plan {
        let action = |values: &&[f32]| Action {
            header: Header {
                frame_id: frame_id.to_owned(),
                ..Header::default()
            },
            values: values.to_vec(),
        };
        Plan {
            actions: values.iter().map(action).collect(),
            period: Duration::from_nanos(400_000_000),
            lead_steps: 1,
            ..Plan::default()
        }
    }

    #[test]
    fn path_starts_at_the_end_effector_and_adds_up_motions() {
        let values: [&[f32]; 2] = [
            &[0.5, 0.0, -0.25, 0.1, 0.1, 0.1, 1.0],
            &[0.0, 0.25, 0.0, 0.0, 0.0, 0.0, 1.0],
        ];
        let plan = plan(&values, "base_link");
        let shapes = markers(&plan, [0.25, 0.0, 0.5], &ActionSpace::bridge()).unwrap();
        let [way, end] = &shapes.markers[..] else {
            panic!("{shapes:?}")
        };
        let points: Vec<_> = way.points.iter().map(|at| [at.x, at.y, at.z]).collect();
        assert_eq!(
            points,
            [[0.25, 0.0, 0.5], [0.75, 0.0, 0.25], [0.75, 0.25, 0.25]]
        );
        assert_eq!(
            (way.r#type, end.r#type),
            (Marker::LINE_STRIP, Marker::SPHERE)
        );
        assert_eq!((way.ns.as_str(), way.id, end.id), ("plan", 0, 1));
        assert_eq!(end.pose.position, way.points[2]);
        assert_eq!(way.lifetime.to_nanos(), 3 * 400_000_000);
        assert_eq!(way.header.frame_id, "base_link");
    }

    #[test]
    fn actions_of_joints_and_of_no_frame_have_no_way() {
        let joints: ActionSpace = serde_json::from_str(
            r#"{"name": "joints", "dimensions": [{"name": "a", "unit": "rad", "kind": "joint_delta"}]}"#,
        )
        .unwrap();
        let plan_of_joints = plan(&[&[0.1]], "base_link");
        assert_eq!(markers(&plan_of_joints, [0.0; 3], &joints), None);
        let bridge = ActionSpace::bridge();
        let nowhere = plan(&[&[0.0; 7]], "");
        assert_eq!(markers(&nowhere, [0.0; 3], &bridge), None);
        assert_eq!(markers(&plan(&[], "base_link"), [0.0; 3], &bridge), None);
        // A message that is shorter than the space.
        let short = plan(&[&[0.0; 2]], "base_link");
        assert_eq!(markers(&short, [0.0; 3], &bridge), None);
    }
}

//! Markers for viewers. All nodes publish them on the topic `markers`, where a marker's `ns` names its meaning. Each
//! vanishes after its lifetime, so a viewer shows nothing stale.

use std::time::Duration;

use wm_msgs::{
    builtin_interfaces::Duration as RosDuration,
    geometry_msgs::{Point, Pose, Vector3},
    std_msgs::{ColorRGBA, Header},
    visualization_msgs::Marker,
};

/// x, y and z \[m\].
pub type Position = [f64; 3];

/// Width of lines \[m\]: visible across a table, and thinner than a finger.
const LINE_M: f64 = 0.003;

/// The namespace and look of a marker.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    /// The namespace, by which viewers show and hide markers.
    pub ns: &'static str,
    /// Red, green, blue and opacity, 0 to 1.
    pub color: [f32; 4],
    /// The marker vanishes after this time unless it is renewed.
    pub lifetime: Duration,
}

impl Style {
    fn marker(&self, header: Header, r#type: i32) -> Marker {
        let [r, g, b, a] = self.color;
        // longer lifetimes mean forever
        let lifetime_ns = i64::try_from(self.lifetime.as_nanos()).unwrap_or(i64::MAX);
        Marker {
            header,
            ns: self.ns.to_owned(),
            r#type,
            action: Marker::ADD,
            color: ColorRGBA { r, g, b, a },
            lifetime: RosDuration::from_nanos(lifetime_ns),
            ..Marker::default()
        }
    }
}

fn point([x, y, z]: Position) -> Point {
    Point { x, y, z }
}

/// A line through all positions.
pub fn path(header: Header, style: &Style, positions: &[Position]) -> Marker {
    Marker {
        scale: Vector3 {
            x: LINE_M,
            ..Vector3::default()
        },
        points: positions.iter().copied().map(point).collect(),
        ..style.marker(header, Marker::LINE_STRIP)
    }
}

/// A ball.
pub fn ball(header: Header, style: &Style, middle: Position, radius_m: f64) -> Marker {
    let across = 2.0 * radius_m;
    Marker {
        pose: Pose {
            position: point(middle),
            ..Pose::default()
        },
        scale: Vector3 {
            x: across,
            y: across,
            z: across,
        },
        ..style.marker(header, Marker::SPHERE)
    }
}

/// The twelve edges of an axis-aligned box, through which its content stays visible.
pub fn edges(header: Header, style: &Style, least: Position, most: Position) -> Marker {
    let corner = |bits: usize| {
        let mut corner = least;
        for (axis, (slot, far)) in corner.iter_mut().zip(most).enumerate() {
            if bits & (1 << axis) != 0 {
                *slot = far;
            }
        }
        point(corner)
    };
    // from each corner along the axes of which it is the near end
    let points = (0..8_usize).flat_map(|from| {
        let axes = (0..3).filter(move |axis| from & (1 << axis) == 0);
        axes.flat_map(move |axis| [corner(from), corner(from | (1 << axis))])
    });
    Marker {
        scale: Vector3 {
            x: LINE_M,
            ..Vector3::default()
        },
        points: points.collect(),
        ..style.marker(header, Marker::LINE_LIST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STYLE: Style = Style {
        ns: "test",
        color: [1.0, 0.5, 0.0, 0.25],
        lifetime: Duration::from_millis(1500),
    };

    #[test]
    fn box_has_twelve_axis_aligned_edges_between_its_corners() {
        let (least, most) = ([0.0, -1.0, 2.0], [1.0, 3.0, 2.5]);
        let marker = edges(Header::default(), &STYLE, least, most);
        assert_eq!(marker.r#type, Marker::LINE_LIST);
        let edges: Vec<_> = marker
            .points
            .chunks(2)
            .map(|ends| [ends[0], ends[1]])
            .collect();
        assert_eq!(edges.len(), 12);
        let mut length = 0.0;
        for [from, to] in &edges {
            let along = [to.x - from.x, to.y - from.y, to.z - from.z];
            assert_eq!(along.iter().filter(|part| **part != 0.0).count(), 1);
            length += along.iter().sum::<f64>();
            for ([x, y, z], end) in [from, to].map(|end| ([end.x, end.y, end.z], end)) {
                let is_corner = [least, most].iter().any(|side| side[0] == x)
                    && [least, most].iter().any(|side| side[1] == y)
                    && [least, most].iter().any(|side| side[2] == z);
                assert!(is_corner, "{end:?}");
            }
        }
        assert_eq!(length, 4.0 * (1.0 + 4.0 + 0.5));
    }

    #[test]
    fn markers_have_the_style_and_a_valid_pose() {
        let marker = ball(Header::default(), &STYLE, [1.0, 2.0, 3.0], 0.1);
        assert_eq!((marker.ns.as_str(), marker.color.a), ("test", 0.25));
        assert_eq!(marker.lifetime.to_nanos(), 1_500_000_000);
        // RViz refuses a quaternion of zeros
        assert_eq!(marker.pose.orientation.w, 1.0);
        assert_eq!((marker.scale.x, marker.scale.z), (0.2, 0.2));
        let line = path(Header::default(), &STYLE, &[[0.0; 3], [1.0; 3]]);
        assert_eq!((line.points.len(), line.pose.orientation.w), (2, 1.0));
    }
}

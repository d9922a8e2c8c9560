//! The view's parameters.

use crate::{command::Permission, inputs::CAMERA};
use std::path::PathBuf;

/// Where the axes of the bundled bag's actions point in its pictures: right and down for x, y and z \[picture widths per m\].
pub(crate) const AXES: [f64; 6] = [2.93, -0.15, -0.23, -1.84, 0.0, -2.29];

/// The page's port, unless a parameter names another.
pub(crate) const PORT: u16 = 8765;
wm_ros::parameters! {
    /// The node's parameters.
    pub(crate) struct Parameters {
        /// Bag to show instead of what the nodes publish; empty: live.
        pub bag: PathBuf = "";
        /// Address that the page is served on. On another one than loopback, a token is needed, which the node prints.
        pub address: String = "127.0.0.1";
        /// Port that the page is served on; 0: any free one.
        pub port: u16 = PORT;
        /// File whose first line is the token that clients must have; empty: none on loopback, elsewhere a new one.
        pub token_file: PathBuf = "";
        /// Names that this host is called by, beside its addresses and localhost.
        pub hosts: Vec<String> = Vec::<String>::new();
        /// What the page may do beyond looking and stopping the executor: nothing; goals, candidates and resets; or all of
        /// it, which arms the executor too.
        pub control: Permission = "none", one_of {
            "none" => Permission::Nothing,
            "goals" => Permission::Goals,
            "all" => Permission::All,
        };
        /// Image topic of the camera; its sibling /compressed is preferred.
        pub camera_topic: String = CAMERA;
        /// Memory for the pictures of the last minute [MiB].
        pub memory: usize = 64, in 1..=4096;
        /// Number of clients at a time.
        pub max_clients: usize = 16, in 1..=256;
        /// Topics that Foxglove and Lichtblick can read: those whose name contains a match of this regular expression; empty:
        /// none, and their protocol is not spoken.
        pub foxglove_regex: String = ".*";
        /// Topics that they cannot read: those whose name contains a match of this regular expression; empty: all can.
        pub foxglove_exclude_regex: String = "";
        /// Highest rates for them, each as EXPRESSION=HZ: topics whose name contains a match of the expression are thinned out
        /// to so many messages a second. The first that matches counts; topics that are latched are not thinned out.
        pub foxglove_rates: Vec<String> = Vec::<String>::new();
        /// Origins whose pages may connect as such a viewer. file:// is that of desktop applications, and of no website; for
        /// Foxglove in a browser add https://app.foxglove.dev.
        pub foxglove_origins: Vec<String> = vec!["file://".to_owned()];
        /// Where the axes of actions point in the picture: right and down for x, y and z [picture widths per m]. For the
        /// arrows of a plan where the camera's place or the end effector's is not known.
        pub axes: Vec<f64> = AXES.to_vec();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_sim::render::{Camera, IMAGE_SIZE};

    /// A change of 1 cm at the middle of the bundled camera's view, on each axis.
    #[test]
    fn the_default_axes_are_those_of_the_bundled_camera() {
        let camera = Camera::beside_the_arm();
        let middle = [0.262, 0.0, 0.095];
        let pixel = |point: [f64; 3]| camera.pixel(&point.into()).unwrap();
        let from = pixel(middle);
        for axis in 0..3 {
            let mut point = middle;
            point[axis] += 0.01;
            let to = pixel(point);
            for side in 0..2 {
                let widths = f64::from(to[side] - from[side]) / f64::from(IMAGE_SIZE) / 0.01;
                let expected = AXES[2 * axis + side];
                // Perspective over the centimetre.
                assert!((widths - expected).abs() < 0.06, "{axis} {side}: {widths}");
            }
        }
    }
}

//! Checks of a playback that are possible before anything starts.

use super::{NODE, playlist::require_actions, settings::ACTION_TOPIC};
use anyhow::Result;
use std::path::Path;
use wm_bag::BagReader;
use wm_camera::goal::camera_topic;
use wm_ros::NodeArgs;

/// Checks that a player with these arguments, started in `folder`, finds its bag, and in it the camera and the actions of
/// its parameters. A launch can refuse a mistyped path before its recorder and its report touch earlier results.
///
/// # Errors
/// Those of the player.
pub fn check(args: &NodeArgs, folder: &Path) -> Result<()> {
    let text = |name: &str| -> Result<String> {
        let value = args.given(NODE.name, wm_ros::NAMESPACE, name)?;
        // The default of these parameters is empty.
        Ok(value.unwrap_or_default())
    };
    let bag = text("bag")?;
    if bag.is_empty() {
        // The player itself reports the missing parameter.
        return Ok(());
    }
    let reader = BagReader::open(folder.join(bag))?;
    let has_goal: Option<bool> = args.given(NODE.name, wm_ros::NAMESPACE, "goal")?;
    if has_goal == Some(true) {
        camera_topic(&reader, &text("camera_topic")?)?;
    }
    let chunk_length: Option<i64> =
        args.given(NODE.name, wm_ros::NAMESPACE, "action_chunk_length")?;
    if chunk_length.is_some_and(|length| length > 0) {
        let topic = text("action_topic")?;
        let topic = match topic.as_str() {
            "" => ACTION_TOPIC,
            topic => topic,
        };
        require_actions(&reader, topic)?;
    }
    Ok(())
}

//! Checks of a playback that are possible before anything starts.

use super::{NODE, playlist::require_actions, settings::ACTION_TOPIC};
use anyhow::Result;
use std::path::Path;
use wm_bag::BagReader;
use wm_camera::goal::camera_topic;
use wm_ros::NodeArgs;

/// Whether a player with these arguments, started in `folder`, finds its bag, and in it the camera and the actions that it
/// is told. So a launch can refuse a mistyped path before its recorder and its report touch what an earlier one has left.
///
/// # Errors
/// As the player would say it.
pub fn check(args: &NodeArgs, folder: &Path) -> Result<()> {
    let text = |name: &str| -> Result<String> {
        let given = args.given(NODE.name, wm_ros::NAMESPACE, name)?;
        Ok(given.unwrap_or_default())
    };
    let bag = text("bag")?;
    if bag.is_empty() {
        // The player names the parameter.
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
        let given = text("action_topic")?;
        let topic = if given.is_empty() {
            ACTION_TOPIC
        } else {
            given.as_str()
        };
        require_actions(&reader, topic)?;
    }
    Ok(())
}

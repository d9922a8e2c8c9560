//! The parameter `action_space`.

use std::path::Path;

use anyhow::{Context as _, Result};
use wm_motion::actions::ActionSpace;

/// The action space of a YAML or JSON file; that of Bridge V2 if no file is named.
///
/// # Errors
/// Names the file that cannot be read, or its fault.
pub(crate) fn action_space(path: &Path) -> Result<ActionSpace> {
    if path.as_os_str().is_empty() {
        return Ok(ActionSpace::bridge());
    }
    let named = || format!("parameter action_space is {}", path.display());
    let text = std::fs::read_to_string(path).with_context(named)?;
    // JSON is YAML.
    serde_yaml_ng::from_str(&text).with_context(named)
}

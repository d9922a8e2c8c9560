//! The action space in a bag's metadata.

use super::{ActionError, ActionSpace};

impl ActionSpace {
    /// Key of the action space in a bag's `custom_data` (`metadata.yaml`).
    pub const NOTE: &str = "action_space";

    /// As JSON, in the format of `model.json`.
    ///
    /// # Errors
    /// [`ActionError::Space`] if serialisation fails.
    pub fn to_note(&self) -> Result<String, ActionError> {
        serde_json::to_string(self).map_err(|error| ActionError::Space(error.to_string()))
    }

    /// The action space of a bag: its metadata entry; Bridge V2 if missing, since bags older than the entry used it.
    ///
    /// # Errors
    /// [`ActionError::Space`] if the entry does not describe an action space.
    pub fn of_note(note: Option<&str>) -> Result<Self, ActionError> {
        let Some(note) = note else {
            return Ok(Self::bridge());
        };
        let refused =
            |error| ActionError::Space(format!("{} in metadata.yaml: {error}", Self::NOTE));
        serde_json::from_str(note).map_err(refused)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn note_round_trips() {
        let space = ActionSpace::bridge();
        let note = space.to_note().unwrap();
        assert_eq!(ActionSpace::of_note(Some(&note)).unwrap(), space);
        assert_eq!(ActionSpace::of_note(None).unwrap(), space);
        let error = ActionSpace::of_note(Some("{}")).unwrap_err().to_string();
        assert!(error.contains("action_space in metadata.yaml"), "{error}");
    }
}

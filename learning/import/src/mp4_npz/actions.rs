use std::path::Path;

use super::arrays::{Arrays, Label};
use crate::{ImportError, mapping::VALUES};

/// Scales of stored position deltas (per m) and rotation deltas (per rad).
const POSITION_SCALE: f32 = 35.0;
const ROTATION_SCALE: f32 = 5.6;
/// Columns of the array: seven values, and zeros up to the model's action size.
const COLUMNS: u64 = 10;
/// Names of the array of actions: the authors', and NumPy's default.
const ACTIONS: [&str; 2] = ["actions", "arr_0"];
const SUCCESS: &str = "success";
const INSTRUCTION: &str = "language_instruction";

/// The actions and labels of an episode.
#[derive(Debug)]
pub(super) struct LabelledActions {
    /// dx dy dz in m, droll dpitch dyaw in rad, gripper 0 closed to 1 open.
    pub actions: Vec<[f32; VALUES]>,
    pub instruction: Option<String>,
    pub success: Option<bool>,
    /// Remarks about ignored content.
    pub notes: Vec<String>,
}

/// Reads the actions of an `.npz` in physical units, and its labels, if any.
///
/// The array `actions`, or `arr_0`, is (T, 10) float32: xyz x 35, rpy x 5.6, gripper open -1 / closed +1, three zeros.
/// `success` is 0 or 1, `language_instruction` a text, as the authors' downloader writes them for Bridge V2 and SOAR.
pub(super) fn read(file: &Path) -> Result<LabelledActions, ImportError> {
    read_labelled(file).map_err(|reason| ImportError::corrupt(file, reason))
}

fn read_labelled(file: &Path) -> Result<LabelledActions, String> {
    let mut arrays = Arrays::open(file)?;
    let name = ACTIONS.into_iter().find(|name| arrays.has(name));
    let name = name.ok_or_else(|| "expected an array named actions or arr_0 in it".to_owned())?;
    let array = arrays.numbers(name)?;
    let &[_, COLUMNS] = array.shape.as_slice() else {
        return Err(format!(
            "expected {name}.npy of shape (T, {COLUMNS}), got {:?}",
            array.shape
        ));
    };
    let rows = array.values.chunks_exact(COLUMNS as usize).enumerate();
    let actions = rows.map(|(row, scaled)| {
        undo_scaling(scaled).map_err(|reason| format!("{name}.npy, row {row}: {reason}"))
    });
    let actions = actions.collect::<Result<_, _>>()?;
    let mut notes = Vec::new();
    let mut label = |name: &str| {
        let label = match arrays.has(name) {
            true => arrays.label(name)?,
            false => return Ok(None),
        };
        if label == Label::Pickled {
            notes.push(format!(
                "{name} is a pickled Python object, expected a number or a text"
            ));
            return Ok(None);
        }
        Ok::<_, String>(Some(label))
    };
    let success = match label(SUCCESS)? {
        None => None,
        Some(Label::Number(number)) if number == 0.0 || number == 1.0 => Some(number == 1.0),
        Some(other) => return Err(format!("{SUCCESS}: expected 0 or 1, got {other}")),
    };
    let instruction = match label(INSTRUCTION)? {
        None => None,
        Some(Label::Text(text)) => (!text.is_empty()).then_some(text),
        Some(other) => return Err(format!("{INSTRUCTION}: expected a text, got {other}")),
    };
    let known = [name, SUCCESS, INSTRUCTION];
    let mut others = arrays.names();
    others.retain(|name| !known.contains(&name.as_str()));
    others.sort_unstable();
    if !others.is_empty() {
        notes.push(format!(
            "arrays without a topic are ignored: {}",
            others.join(", ")
        ));
    }
    Ok(LabelledActions {
        actions,
        instruction,
        success,
        notes,
    })
}

/// Undoes the scaling of one row.
fn undo_scaling(scaled: &[f32]) -> Result<[f32; VALUES], String> {
    let Some((&[x, y, z, roll, pitch, yaw, gripper], padding)) =
        scaled.split_first_chunk::<VALUES>()
    else {
        return Err(format!("expected {COLUMNS} values, got {}", scaled.len()));
    };
    // Actions of another robot or encoding would give wrong values.
    if padding.iter().any(|value| *value != 0.0) {
        return Err(format!(
            "expected zeros after the first {VALUES} values, got {padding:?}"
        ));
    }
    if !(-1.0..=1.0).contains(&gripper) {
        return Err(format!(
            "expected the gripper within -1 (open) to 1 (closed), got {gripper}"
        ));
    }
    Ok([
        x / POSITION_SCALE,
        y / POSITION_SCALE,
        z / POSITION_SCALE,
        roll / ROTATION_SCALE,
        pitch / ROTATION_SCALE,
        yaw / ROTATION_SCALE,
        (1.0 - gripper) / 2.0,
    ])
}

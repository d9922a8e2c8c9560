use std::{
    fs::File,
    io::{BufReader, Read as _},
    path::Path,
};

use npyz::{NpyFile, Order};
use zip::ZipArchive;

use crate::{ImportError, episode::VALUES};

/// Position deltas are stored times this (per m), rotation deltas times the other (per rad).
const POSITION_SCALE: f32 = 35.0;
const ROTATION_SCALE: f32 = 5.6;
/// Columns of the array: the seven values, and zeros that pad them to the model's action size.
const COLUMNS: u64 = 10;
/// No episode's actions come near this; a larger array is not one.
const MAX_BYTES: u64 = 64 << 20;

/// The actions of an `.npz` in physical units: dx dy dz in m, droll dpitch dyaw in rad, gripper 0 closed to 1 open.
///
/// The array is `actions`, or `arr_0`, the name NumPy gives an array without one: (T, 10) float32 of xyz x 35, rpy x
/// 5.6, gripper open -1 / closed +1, three zeros.
pub(super) fn read(file: &Path) -> Result<Vec<[f32; VALUES]>, ImportError> {
    let corrupt = |reason: String| ImportError::corrupt(file, reason);
    let stream = File::open(file).map_err(|source| ImportError::io(file, source))?;
    let mut archive = ZipArchive::new(BufReader::new(stream))
        .map_err(|error| corrupt(format!("not an npz: {error}")))?;
    let name = ["actions.npy", "arr_0.npy"]
        .into_iter()
        .find(|name| archive.index_for_name(name).is_some())
        .ok_or_else(|| corrupt("expected an array named actions or arr_0 in it".to_owned()))?;
    let mut bytes = Vec::new();
    archive
        .by_name(name)
        .map_err(|error| corrupt(error.to_string()))?
        .take(MAX_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| corrupt(format!("{name}: {error}")))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(corrupt(format!("{name} has more than {MAX_BYTES} bytes")));
    }
    let array = NpyFile::new(&bytes[..]).map_err(|error| corrupt(format!("{name}: {error}")))?;
    let &[rows, COLUMNS] = array.shape() else {
        return Err(corrupt(format!(
            "expected {name} of shape (T, {COLUMNS}), got {:?}",
            array.shape()
        )));
    };
    if array.order() != Order::C {
        return Err(corrupt(format!(
            "expected {name} in row-major (C) order, got Fortran order"
        )));
    }
    let held = bytes.len() as u64 / 4 / COLUMNS;
    if rows > held {
        return Err(corrupt(format!("{name} claims {rows} rows but has {held}")));
    }
    let array = NpyFile::new(&bytes[..]).map_err(|error| corrupt(format!("{name}: {error}")))?;
    let values: Vec<f32> = array
        .into_vec()
        .map_err(|error| corrupt(format!("{name}: {error}")))?;
    values
        .chunks_exact(COLUMNS as usize)
        .enumerate()
        .map(|(row, scaled)| {
            physical(scaled).map_err(|reason| corrupt(format!("{name}, row {row}: {reason}")))
        })
        .collect()
}

/// Undoes the scaling of one row.
fn physical(scaled: &[f32]) -> Result<[f32; VALUES], String> {
    let Some((&[x, y, z, roll, pitch, yaw, gripper], padding)) =
        scaled.split_first_chunk::<VALUES>()
    else {
        return Err(format!("expected {COLUMNS} values, got {}", scaled.len()));
    };
    // An action of another embodiment or encoding would come out as nonsense.
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

//! Writes findings and strips.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use image::RgbImage;
use serde::Serialize;
use wm_bag::set_aside;
use wm_metrics::findings::ClosedLoop;

/// Writes `TASK.json` and, if given, `TASK.png` into `folder`, and makes the folder if it is missing. Older files of
/// these names are renamed by their time.
///
/// # Errors
/// Names the file that cannot be written.
pub(crate) fn write<A: Serialize>(
    folder: &Path,
    task: &str,
    findings: &ClosedLoop<A>,
    strip: Option<&RgbImage>,
) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder).with_context(|| format!("folder {}", folder.display()))?;
    let mut written = Vec::new();
    let mut place = |extension: &str| -> Result<PathBuf> {
        let path = folder.join(format!("{task}.{extension}"));
        set_aside(&path)?;
        written.push(path.clone());
        Ok(path)
    };
    let json = place("json")?;
    std::fs::write(&json, findings.to_json()?)
        .with_context(|| format!("write {}", json.display()))?;
    if let Some(strip) = strip {
        let png = place("png")?;
        strip
            .save(&png)
            .with_context(|| format!("write {}", png.display()))?;
    }
    Ok(written)
}

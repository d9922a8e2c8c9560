//! A report's files: `report.json`, `report.md`, `strip.png`.

use super::{Scorer, figures::Report, strip::picture_strip, table::markdown};
use anyhow::{Context as _, Result};
use std::path::{Path, PathBuf};

/// Writes the scorer's report into `folder`, which is made where it is missing, and replaces an older one there. The
/// strip is written only where a rollout was seen whole.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_report(
    scorer: &Scorer,
    source: &str,
    folder: &Path,
) -> Result<(Report, Vec<PathBuf>)> {
    std::fs::create_dir_all(folder).with_context(|| format!("folder {}", folder.display()))?;
    let report = scorer.report(source);
    let mut written = Vec::new();
    let mut write = |name: &str, bytes: &[u8]| -> Result<()> {
        let path = folder.join(name);
        std::fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))?;
        written.push(path);
        Ok(())
    };
    write("report.json", &serde_json::to_vec_pretty(&report)?)?;
    write("report.md", markdown(&report).as_bytes())?;
    if let Some(rollout) = scorer.shown_rollout() {
        let mut png = std::io::Cursor::new(Vec::new());
        picture_strip(rollout, report.step_period_s).write_to(&mut png, image::ImageFormat::Png)?;
        write("strip.png", png.get_ref())?;
    }
    Ok((report, written))
}

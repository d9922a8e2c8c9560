//! A report's files: `report.json`, `report.md`, `strip.png`.

use super::{
    Scorer,
    figures::Report,
    strip::{STRIP, picture_strip},
    table::markdown,
};
use anyhow::{Context as _, Result};
use std::path::{Path, PathBuf};
use wm_bag::free_name;

const JSON: &str = "report.json";
const MARKDOWN: &str = "report.md";

/// Writes the scorer's report into `folder`, and makes the folder if it is missing. An older report there moves to a
/// folder beside it that has its time. The strip is missing if no predicted picture has a frame of the same time.
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
    let strip = match scorer.shown_rollout() {
        Some(rollout) => {
            let mut png = std::io::Cursor::new(Vec::new());
            let picture = picture_strip(rollout, report.step_period_s);
            picture.write_to(&mut png, image::ImageFormat::Png)?;
            Some(png.into_inner())
        }
        None => None,
    };
    set_older_aside(folder).with_context(|| format!("the older report in {}", folder.display()))?;
    let mut written = Vec::new();
    let mut write = |name: &str, bytes: &[u8]| -> Result<()> {
        let path = folder.join(name);
        std::fs::write(&path, bytes).with_context(|| format!("write {}", path.display()))?;
        written.push(path);
        Ok(())
    };
    write(JSON, &serde_json::to_vec_pretty(&report)?)?;
    write(MARKDOWN, markdown(&report, strip.is_some()).as_bytes())?;
    if let Some(strip) = strip {
        write(STRIP, &strip)?;
    }
    Ok((report, written))
}

/// Moves the files of an older report into a folder of their own.
fn set_older_aside(folder: &Path) -> Result<()> {
    let files = [JSON, MARKDOWN, STRIP].map(|name| folder.join(name));
    let times = files
        .iter()
        .filter_map(|file| file.metadata().ok()?.modified().ok());
    let Some(newest) = times.max() else {
        return Ok(());
    };
    let older = free_name(&folder.join("report"), newest)?;
    std::fs::create_dir(&older)?;
    for file in files.iter().filter(|file| file.exists()) {
        if let Some(name) = file.file_name() {
            std::fs::rename(file, older.join(name))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn older_report_and_its_strip_are_kept_apart() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("out");
        std::fs::create_dir(&folder).unwrap();
        for name in [JSON, MARKDOWN, STRIP] {
            std::fs::write(folder.join(name), "older").unwrap();
        }
        let (_, files) = write_report(&Scorer::default(), "live", &folder).unwrap();
        assert_eq!(files, [folder.join(JSON), folder.join(MARKDOWN)]);
        assert!(!folder.join(STRIP).exists());
        let text = std::fs::read_to_string(folder.join(MARKDOWN)).unwrap();
        assert!(!text.contains(STRIP), "{text}");
        let folders = std::fs::read_dir(&folder).unwrap();
        let mut folders = folders
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.is_dir());
        let older = folders.next().unwrap();
        for name in [JSON, MARKDOWN, STRIP] {
            assert_eq!(std::fs::read_to_string(older.join(name)).unwrap(), "older");
        }
        assert_eq!(folders.next(), None);
    }
}

use std::path::{Component, Path, PathBuf};

/// Fills a path template such as `data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet`: the fields `{name}` and
/// `{name:0Nd}` of Python's `format`.
///
/// # Errors
/// An unknown name or format, or a path outside the folder.
pub(crate) fn fill(
    template: &str,
    texts: &[(&str, &str)],
    numbers: &[(&str, i64)],
) -> Result<PathBuf, String> {
    let mut filled = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        filled.push_str(before);
        let (field, after) = after
            .split_once('}')
            .ok_or_else(|| format!("{template:?}: expected a closing brace"))?;
        let (name, format) = field.split_once(':').unwrap_or((field, ""));
        let text = texts.iter().find(|(known, _)| *known == name);
        let number = numbers.iter().find(|(known, _)| *known == name);
        match (text, number, width(format)) {
            (Some((_, text)), None, Some(0)) => filled.push_str(text),
            (None, Some((_, number)), Some(width)) => {
                filled.push_str(&format!("{number:0width$}"));
            }
            _ => return Err(format!("{template:?}: the field {{{field}}} is unknown")),
        }
        rest = after;
    }
    filled.push_str(rest);
    let path = PathBuf::from(filled);
    if !is_inside(&path) {
        return Err(format!(
            "{template:?}: expected a path inside the data set, got {}",
            path.display()
        ));
    }
    Ok(path)
}

/// N of `0Nd`; 0 without a format.
fn width(format: &str) -> Option<usize> {
    if format.is_empty() {
        return Some(0);
    }
    let digits = format.strip_prefix('0')?.strip_suffix('d')?;
    // Longer than the numbers of any path.
    digits.parse().ok().filter(|width| *width <= 20)
}

fn is_inside(path: &Path) -> bool {
    let mut parts = path.components();
    parts.all(|part| matches!(part, Component::Normal(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lerobot_paths_are_filled() {
        let numbers = [("chunk_index", 2), ("file_index", 1234)];
        assert_eq!(
            fill(
                "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
                &[("video_key", "observation.images.front")],
                &numbers
            ),
            Ok("videos/observation.images.front/chunk-002/file-1234.mp4".into())
        );
        for (bad, part) in [
            ("data/{other}", "unknown"),
            ("data/{chunk_index:>3}", "unknown"),
            ("data/{chunk_index", "closing brace"),
            ("../{chunk_index}", "inside the data set"),
            ("/{chunk_index}", "inside the data set"),
        ] {
            let error = fill(bad, &[], &numbers).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
        let error = fill("{video_key}", &[("video_key", "../x")], &[]).unwrap_err();
        assert!(error.contains("inside the data set"), "{error}");
    }
}

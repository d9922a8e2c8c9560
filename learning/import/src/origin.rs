use std::path::Path;

/// What a bag notes as its origin, under [`wm_bag::ORIGIN`]: the name of the dataset's folder, the file in it and, after
/// `#`, the episode's number there, where one file holds several. Without the folders above, which are this machine's.
pub fn origin(dataset: &Path, file: Option<&Path>, number: Option<i64>) -> String {
    // `.` has a name only when it is resolved.
    let resolved = dataset.canonicalize();
    let dataset_name = resolved.as_deref().unwrap_or(dataset).file_name();
    let mut parts: Vec<String> = Vec::new();
    parts.extend(dataset_name.map(|name| name.to_string_lossy().into_owned()));
    if let Some(below) = file.map(|file| file.strip_prefix(dataset).unwrap_or(file))
        // The dataset may be that file itself.
        && !below.as_os_str().is_empty()
    {
        parts.push(below.display().to_string());
    }
    let path = parts.join("/");
    match number {
        Some(number) => format!("{path}#{number}"),
        None => path,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_names_dataset_file_and_number() {
        let scratch = tempfile::tempdir().unwrap();
        let dataset = scratch.path().join("bridge_v2");
        std::fs::create_dir(&dataset).unwrap();
        let file = dataset.join("train/a.tfrecord");
        let of = |file, number| origin(&dataset, file, number);
        assert_eq!(
            of(Some(file.as_path()), Some(3)),
            "bridge_v2/train/a.tfrecord#3"
        );
        assert_eq!(of(Some(file.as_path()), None), "bridge_v2/train/a.tfrecord");
        assert_eq!(of(None, Some(12)), "bridge_v2#12");
        // However its path is written, and where it is one file.
        let roundabout = dataset.join("../bridge_v2/.");
        assert_eq!(origin(&roundabout, None, Some(0)), "bridge_v2#0");
        assert_eq!(origin(&file, Some(file.as_path()), Some(1)), "a.tfrecord#1");
    }
}

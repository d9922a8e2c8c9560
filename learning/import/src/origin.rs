use std::path::Path;

/// The origin in a bag's note [`wm_bag::ORIGIN`]: the data set's folder, the file in it and, after `#`, the episode's number,
/// if the file has several. Parent folders are omitted: they belong to this machine.
pub(crate) fn origin(dataset: &Path, file: Option<&Path>, number: Option<i64>) -> String {
    // `.` has a name only after it is resolved.
    let resolved = dataset.canonicalize();
    let dataset_name = resolved.as_deref().unwrap_or(dataset).file_name();
    let mut parts: Vec<String> = Vec::new();
    parts.extend(dataset_name.map(|name| name.to_string_lossy().into_owned()));
    if let Some(below) = file.map(|file| file.strip_prefix(dataset).unwrap_or(file))
        // The data set may be the file itself.
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
    fn origin_names_data_set_file_and_number() {
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
        // With another form of the path, and for a single file.
        let roundabout = dataset.join("../bridge_v2/.");
        assert_eq!(origin(&roundabout, None, Some(0)), "bridge_v2#0");
        assert_eq!(origin(&file, Some(file.as_path()), Some(1)), "a.tfrecord#1");
        assert_eq!(origin(&file, Some(file.as_path()), None), "a.tfrecord");
    }
}

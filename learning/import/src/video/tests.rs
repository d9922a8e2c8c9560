#![allow(clippy::unwrap_used)]

use super::*;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fixtures/video")
}

/// Videos that this build can decode.
fn videos() -> Vec<PathBuf> {
    let files = fs::read_dir(folder())
        .unwrap()
        .map(|file| file.unwrap().path());
    let is_decoded = |file: &PathBuf| {
        let name = file.file_name().unwrap().to_str().unwrap();
        name.ends_with(".mp4") && (cfg!(feature = "av1") || !name.contains("av1"))
    };
    files.filter(is_decoded).collect()
}

/// Tolerance against ffmpeg, which rounds down \[levels\].
const TOLERANCE: u8 = 3;

#[test]
fn colours_equal_those_of_ffmpeg() {
    let mut compared = 0;
    for file in videos() {
        let picture = file.with_extension("png");
        if !picture.exists() {
            continue;
        }
        let expected = image::open(picture).unwrap().into_rgb8();
        let mut frames = Vec::new();
        let each = |frame| {
            frames.push(frame);
            Ok(())
        };
        Video::open(&file).unwrap().decode(1..2, each).unwrap();
        let [frame] = frames.as_slice() else {
            panic!("{}: {} frames", file.display(), frames.len());
        };
        assert_eq!(frame.dimensions(), expected.dimensions());
        let pairs = frame.as_raw().iter().zip(expected.as_raw());
        let most = pairs.map(|(a, b)| a.abs_diff(*b)).max();
        assert!(most <= Some(TOLERANCE), "{}: {most:?}", file.display());
        compared += 1;
    }
    assert!(compared >= 9, "{compared}");
}

#[test]
fn other_layouts_are_rejected_by_name() {
    let mut refused = 0;
    for file in videos() {
        let name = file.file_name().unwrap().to_str().unwrap();
        if !name.starts_with("refused-") {
            continue;
        }
        let decoded = Video::open(&file).and_then(|video| video.decode(0..1, |_| Ok(())));
        let error = decoded.unwrap_err().to_string();
        assert!(error.contains("yuv420p"), "{name}: {error}");
        refused += 1;
    }
    assert!(refused >= 2, "{refused}");
}

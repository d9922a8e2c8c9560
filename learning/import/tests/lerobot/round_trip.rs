use std::path::{Path, PathBuf};

use image::ImageFormat;
use proptest::prelude::*;
use tempfile::TempDir;
use wm_bag::{BagReader, BagWriter, WriterOptions};
use wm_import::lerobot::{ExportOptions, ImportOptions, export, import};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::{CompressedImage, Image},
    std_msgs::{Bool, Header},
    wm_msgs::Action,
};

use super::made::{CAMERAS, Episode, START_NS, messages, picture, psnr};

/// Writes episodes as bags, exports and imports them again.
fn round_trip(scratch: &Path, episodes: &[Episode], options: &ExportOptions) -> Vec<PathBuf> {
    let bags: Vec<PathBuf> = (0..episodes.len())
        .map(|n| scratch.join(format!("bag_{n}")))
        .collect();
    for (episode, bag) in episodes.iter().zip(&bags) {
        episode.write(bag);
    }
    let dataset = scratch.join("dataset");
    let exported = export(&bags, &dataset, options).unwrap();
    assert_eq!(exported.episodes, episodes.len() as u64);
    assert_eq!(exported.resampled, [""; 0]);
    import(&dataset, &scratch.join("back"), &ImportOptions::default())
        .unwrap()
        .bags
}

/// Compares the pictures of a bag with the originals.
fn check_pictures(bag: &Path, frames: usize) {
    for (number, camera) in CAMERAS.iter().enumerate() {
        let images: Vec<CompressedImage> =
            messages(bag, &format!("/{camera}/image_raw/compressed"));
        assert_eq!(images.len(), frames);
        for (frame, image) in images.iter().enumerate() {
            let decoded =
                image::load_from_memory_with_format(&image.data, ImageFormat::Jpeg).unwrap();
            let psnr = psnr(&decoded.into_rgb8(), &picture(number, frame));
            // h264 and JPEG lose little; subsampled chroma blurs the square's edges. Neighbouring pictures are below 20 dB.
            assert!(psnr > 26.0, "{camera}, frame {frame}: {psnr} dB");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn episodes_survive_a_round_trip(
        actions in prop::collection::vec(prop::collection::vec(
            prop::collection::vec(prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO, 6), 2..9), 1..4),
        one_file_each in any::<bool>(),
    ) {
        let scratch = TempDir::new().unwrap();
        let episodes: Vec<Episode> = actions
            .into_iter()
            .enumerate()
            .map(|(number, actions)| Episode::of(actions, ["lift the lid", "grüße ☕"][number % 2], number % 2 == 0))
            .collect();
        let limit = if one_file_each { 1 } else { 100 << 20 };
        let options = ExportOptions { data_file_bytes: limit, video_file_bytes: limit, ..ExportOptions::default() };
        let back = round_trip(scratch.path(), &episodes, &options);
        prop_assert_eq!(back.len(), episodes.len());
        for (bag, episode) in back.iter().zip(&episodes) {
            let got = Episode::read(bag);
            let bits = |rows: &[Vec<f32>]| -> Vec<u32> { rows.iter().flatten().map(|value| value.to_bits()).collect() };
            prop_assert_eq!(bits(&got.actions), bits(&episode.actions));
            prop_assert_eq!(bits(&got.joints), bits(&episode.joints));
            prop_assert_eq!(&got.stamps, &episode.stamps, "to the nanosecond");
            prop_assert_eq!(&got, episode);
            check_pictures(bag, episode.stamps.len());
        }
    }
}

#[test]
fn episodes_are_chosen_by_number() {
    let scratch = TempDir::new().unwrap();
    let episodes: Vec<Episode> = (0..4).map(|n| Episode::made(3, n as f32)).collect();
    round_trip(scratch.path(), &episodes, &ExportOptions::default());
    let options = ImportOptions {
        episodes: Some(1..=2),
        ..ImportOptions::default()
    };
    let out = scratch.path().join("some");
    let bags = import(&scratch.path().join("dataset"), &out, &options)
        .unwrap()
        .bags;
    assert_eq!(
        bags,
        [out.join("episode_000001"), out.join("episode_000002")]
    );
    assert_eq!(Episode::read(&bags[1]), episodes[2]);
    for (shard, expected) in [("0/3", &["0", "3"][..]), ("1/3", &["1"]), ("4/5", &[])] {
        let options = ImportOptions {
            shard: shard.parse().unwrap(),
            ..ImportOptions::default()
        };
        let out = scratch.path().join(shard.replace('/', "_of_"));
        let bags = import(&scratch.path().join("dataset"), &out, &options)
            .unwrap()
            .bags;
        let expected = expected
            .iter()
            .map(|n| out.join(format!("episode_00000{n}")));
        assert_eq!(bags, expected.collect::<Vec<_>>());
        for bag in bags {
            let number = bag.to_str().unwrap().chars().last().unwrap();
            let number = number.to_digit(10).unwrap() as usize;
            assert_eq!(Episode::read(&bag), episodes[number]);
        }
    }
    let options = ImportOptions {
        episodes: Some(9..=9),
        ..ImportOptions::default()
    };
    let error = import(&scratch.path().join("dataset"), &out, &options)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("has 4 episodes, but none of the requested numbers"),
        "{error}"
    );
}

#[test]
fn bag_has_its_data_set_and_episode_as_note() {
    let scratch = TempDir::new().unwrap();
    let episodes = [Episode::made(3, 0.0), Episode::made(3, 1.0)];
    let back = round_trip(scratch.path(), &episodes, &ExportOptions::default());
    for (number, bag) in back.iter().enumerate() {
        let reader = BagReader::open(bag).unwrap();
        let origin = format!("dataset#{number}");
        assert_eq!(reader.note(wm_bag::ORIGIN), Some(origin.as_str()));
        let shown = reader.summary().to_string();
        assert!(
            shown.contains(&format!("Origin:       {origin}\n")),
            "{shown}"
        );
    }
}

#[test]
fn export_removes_only_its_own_files() {
    let scratch = TempDir::new().unwrap();
    let bag = scratch.path().join("bag");
    Episode::made(3, 0.0).write(&bag);
    let options = ExportOptions::default();
    // Existing files: a folder with content, a file, and the remains of a killed export.
    let kept = ["full/theirs", "file", "new.partial-1/meta"].map(|name| scratch.path().join(name));
    for path in &kept {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "theirs").unwrap();
    }
    let out = |name: &str| scratch.path().join(name);
    let bags = std::slice::from_ref(&bag);
    for taken in ["full", "file"] {
        let error = export(bags, &out(taken), &options).unwrap_err().to_string();
        assert!(error.contains("not an empty folder"), "{error}");
    }
    std::fs::create_dir(out("new")).unwrap();
    export(bags, &out("new"), &options).unwrap();
    for path in &kept {
        assert_eq!(std::fs::read_to_string(path).unwrap(), "theirs");
    }
    let mut left: Vec<_> = std::fs::read_dir(scratch.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    left.sort();
    assert_eq!(left, ["bag", "file", "full", "new", "new.partial-1"]);
    assert!(out("new/meta/info.json").is_file());
}

#[test]
fn action_space_survives_a_round_trip() {
    let scratch = TempDir::new().unwrap();
    let back = round_trip(
        scratch.path(),
        &[Episode::made(3, 0.0)],
        &ExportOptions::default(),
    );
    let space = |bag: &Path| {
        let reader = BagReader::open(bag).unwrap();
        let note = reader.note(ActionSpace::NOTE);
        note.map(|note| ActionSpace::of_note(Some(note)).unwrap())
    };
    assert_eq!(space(&back[0]), Some(ActionSpace::bridge()));

    // For another arm, the names survive; their scales only with the action space.
    let joints = r#"{"name": "my_arm", "dimensions": [
        {"name": "shoulder", "unit": "rad", "kind": "joint_position"},
        {"name": "elbow", "unit": "rad", "kind": "joint_position"}]}"#;
    let joints: ActionSpace = serde_json::from_str(joints).unwrap();
    let bag = scratch.path().join("arm");
    let actions = vec![vec![0.5, 1.0]; 4];
    Episode::of(actions, "wave", true).write_with(&bag, Some(&joints));
    let dataset = scratch.path().join("arm_dataset");
    export(&[bag], &dataset, &ExportOptions::default()).unwrap();
    let info = std::fs::read_to_string(dataset.join("meta/info.json")).unwrap();
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    assert_eq!(
        info["features"]["action"]["names"],
        serde_json::json!(["shoulder", "elbow"])
    );
    let imported = |name: &str, action_space| {
        let options = ImportOptions {
            action_space,
            ..ImportOptions::default()
        };
        import(&dataset, &scratch.path().join(name), &options)
    };
    let derived = space(&imported("unsaid", None).unwrap().bags[0]).unwrap();
    assert_eq!(derived.expect_same(&joints, "", ""), Ok(()), "by name");
    let said = imported("said", Some(joints.clone())).unwrap();
    assert_eq!(space(&said.bags[0]), Some(joints));
    let error = imported("wrong", Some(ActionSpace::bridge())).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("bridge_v2: dx dy dz") && error.contains("shoulder elbow"),
        "{error}"
    );
}

/// A camera at 30 Hz with a missing part, actions at 10 Hz with jitter, and two episodes in one bag.
fn live(bag: &Path) {
    let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
    for number in 0..120u64 {
        let stamp_ns = START_NS + number * 33_333_333;
        let header = Header {
            stamp: Time::from_nanos(stamp_ns as i64),
            frame_id: String::new(),
        };
        if !(60..72).contains(&number) {
            let image = Image {
                header: header.clone(),
                height: 16,
                width: 16,
                encoding: "bgr8".into(),
                step: 48,
                data: [0, 0, number as u8 * 2].repeat(256),
                ..Image::default()
            };
            writer.write("/top/image_raw", &image, stamp_ns).unwrap();
        }
        if number % 3 == 0 {
            let late = (number % 2) * 10_000_000;
            let stamp = Time::from_nanos((stamp_ns + late) as i64);
            let values = vec![number as f32; 3];
            let action = Action {
                header: Header { stamp, ..header },
                values,
            };
            writer
                .write("/wm/action", &action, stamp_ns + late)
                .unwrap();
        }
        if number == 29 || number == 119 {
            writer
                .write(
                    "/task/success",
                    &Bool {
                        data: number == 119,
                    },
                    stamp_ns,
                )
                .unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn live_recording_is_sampled_at_one_rate() {
    let scratch = TempDir::new().unwrap();
    let bag = scratch.path().join("live");
    live(&bag);
    let dataset = scratch.path().join("dataset");
    let exported = export(&[bag], &dataset, &ExportOptions::default()).unwrap();
    assert_eq!((exported.episodes, exported.fps), (2, 10));
    assert_eq!(exported.frames, 10 + 30);
    assert!(
        exported
            .resampled
            .iter()
            .any(|line| line.starts_with("/top/image_raw: 3 of 30 frames repeat a message")),
        "{:?}",
        exported.resampled
    );
    let bags = import(
        &dataset,
        &scratch.path().join("back"),
        &ImportOptions::default(),
    )
    .unwrap()
    .bags;
    let successes: Vec<bool> = bags
        .iter()
        .map(|bag| messages::<Bool>(bag, "/task/success")[0].data)
        .collect();
    assert_eq!(successes, [false, true]);
    let actions: Vec<Action> = messages(&bags[0], "/wm/action");
    let values: Vec<f32> = actions.iter().map(|action| action.values[0]).collect();
    assert_eq!(values, [0., 3., 6., 9., 12., 15., 18., 21., 24., 27.]);
    assert_eq!(BagReader::open(&bags[0]).unwrap().start_ns(), START_NS);
    let images: Vec<CompressedImage> = messages(&bags[0], "/top/image_raw/compressed");
    for (frame, image) in images.iter().enumerate() {
        let red = image::load_from_memory(&image.data)
            .unwrap()
            .into_rgb8()
            .get_pixel(8, 8)[0];
        assert!(red.abs_diff(frame as u8 * 6) < 8, "frame {frame}: {red}");
    }
}

/// Writes a bag with an action and a video camera.
fn write_video(bag: &Path) {
    let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
    let schema = wm_bag::Schema::ros2msg("uint8[] data");
    let (topic, name) = (
        "/camera/image_raw/ffmpeg",
        "foxglove_msgs/msg/CompressedVideo",
    );
    writer
        .write_raw(topic, name, &schema, 1, &[0, 1, 0, 0])
        .unwrap();
    for at in [1_000_000_000, 2_000_000_000] {
        let action = Action {
            values: vec![0.1],
            ..Action::default()
        };
        writer.write("/wm/action", &action, at).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn unsuitable_bags_are_named() {
    let scratch = TempDir::new().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let episode = Episode::made(3, 0.0);
    episode.write(&at("good"));
    let mut wide = episode.clone();
    wide.actions.iter_mut().for_each(|action| action.push(1.0));
    wide.write(&at("wide"));
    let mut nan = episode.clone();
    nan.actions[1][2] = f32::NAN;
    nan.write(&at("nan"));
    BagWriter::create(at("empty"), WriterOptions::default())
        .unwrap()
        .finish()
        .unwrap();
    write_video(&at("video"));
    let error = |names: &[&str], options: &ExportOptions| {
        let bags: Vec<PathBuf> = names.iter().map(|name| at(name)).collect();
        let folder = TempDir::new().unwrap();
        let out = folder.path().join("new/dataset");
        let error = export(&bags, &out, options).unwrap_err().to_string();
        // "wide" is rejected after "good" was written.
        let left = std::fs::read_dir(folder.path().join("new"))
            .unwrap()
            .count();
        assert_eq!(left, 0, "{names:?}");
        error
    };
    let plain = ExportOptions::default();
    let camera = ExportOptions {
        cameras: vec!["/wm/action".into()],
        ..plain.clone()
    };
    for (error, parts) in [
        (
            error(&["good", "wide"], &plain),
            ["wide: action: expected [\"dx\"", "got [\"action_0\""],
        ),
        (
            error(&["nan"], &plain),
            ["nan: /wm/action: a message at", "holds NaN"],
        ),
        (
            error(&["empty"], &plain),
            ["empty: expected messages of /wm/action", "got none"],
        ),
        (
            error(&["good"], &camera),
            [
                "good: expected pictures on /wm/action",
                "no image topic of this name",
            ],
        ),
        (
            error(&["video"], &plain),
            [
                "video: expected a camera",
                "/camera/image_raw/ffmpeg is compressed video",
            ],
        ),
        (error(&["absent"], &plain), ["absent", "no such file"]),
    ] {
        assert!(
            parts.iter().all(|part| error.contains(part)),
            "{parts:?} in {error:?}"
        );
    }
    let error = export(&[at("good")], scratch.path(), &plain)
        .unwrap_err()
        .to_string();
    assert!(error.contains("not an empty folder"), "{error}");
}

//! The camera: what comes, how often, stamped how.

use crate::{Camera, Finding, Heard, Picture, Stream, heard::DEFAULT_CAMERA};
use std::time::Duration;
use wm_model_nodes::cadence::{hertz, rough};
use wm_ros::logging::of_others;

/// This check.
const CHECK: &str = "camera";
/// No pipeline takes so long \[s\].
const CLOCKS_DIFFER_S: f64 = 10.0;
/// The nodes refuse a stamp that is further ahead \[s\].
const REFUSED_S: f64 = 0.1;
/// Stamps ahead by more than a machine's clocks differ when they are in step \[s\].
const AHEAD_S: f64 = 0.02;
/// A frame that is older says little of now: a plan takes as long to compute \[s\].
const LATE_S: f64 = 0.5;
/// Share of frames that may be lost before somebody should look.
const LOST: f64 = 0.02;
/// Longest tenth of the gaps over the median beyond which frames come unevenly: frames are looked for within a quarter of
/// a period.
const UNEVEN: f64 = 1.25;
/// A live picture does not repeat exactly for longer: the encoder's default of `frozen_after` \[s\].
const FROZEN_AFTER_S: f64 = 1.0;
/// Mean and spread of a picture that shows nothing, of values from 0 to 1.
const DARK: f64 = 0.04;
/// As [`DARK`].
const FLAT: f64 = 0.01;

/// What is to be said of the camera that the nodes would use, and of others.
pub(crate) fn check(heard: &Heard, wanted: Option<&str>) -> Vec<Finding> {
    let Some((name, camera)) = heard.camera(wanted) else {
        let unread = heard.unread.iter();
        let unread = unread.map(|advice| Finding::note(CHECK, advice.clone()));
        return [absent(heard, wanted)].into_iter().chain(unread).collect();
    };
    let shown = of_others(name);
    let Some(stream) = camera.best().filter(|stream| !stream.timeline.is_empty()) else {
        return vec![silent(&shown, camera)];
    };
    let mut findings = vec![summary(&shown, camera, stream)];
    findings.extend(pictures(&shown, camera));
    findings.extend(stamps(&shown, stream, heard.clock_ns.is_some()));
    findings.extend(transport(&shown, stream));
    let others: Vec<_> = heard
        .cameras
        .keys()
        .filter(|other| *other != name)
        .map(|other| of_others(other))
        .collect();
    if !others.is_empty() {
        findings.push(
            Finding::note(CHECK, format!("there are others: {}", others.join(", ")))
                .because("a set of nodes takes one camera")
                .fix("camera:=TOPIC to the launch, or wm doctor --camera TOPIC to look at it"),
        );
    }
    if name != DEFAULT_CAMERA {
        findings.push(
            Finding::note(
                CHECK,
                format!("{shown} is not the nodes' default, {DEFAULT_CAMERA}"),
            )
            .fix(format!(
                "wm launch launch-configs/live.launch.yaml camera:={shown}, or wm init DIR"
            )),
        );
    }
    findings
}

fn absent(heard: &Heard, wanted: Option<&str>) -> Finding {
    let finding = match wanted {
        Some(name) => {
            let others: Vec<_> = heard.cameras.keys().map(|name| of_others(name)).collect();
            let others = match others.is_empty() {
                true => "there is no other image topic".to_owned(),
                false => format!("there are {}", others.join(", ")),
            };
            Finding::error(
                CHECK,
                format!("nobody publishes images on {}; {others}", of_others(name)),
            )
        }
        None => Finding::error(
            CHECK,
            "no image topic (sensor_msgs/Image or CompressedImage)",
        ),
    };
    finding
        .because("without frames nothing is predicted")
        .fix("start the camera's driver; if it runs: is it in this domain, and on this host or reached by --interface?")
}

fn silent(name: &str, camera: &Camera) -> Finding {
    if let Some(finding) = camera.streams().find_map(|stream| bad_times(name, stream)) {
        return finding;
    }
    let undecodable = camera.streams().any(|stream| stream.undecodable > 0);
    let finding = match undecodable {
        true => Finding::error(CHECK, format!("{name}: what comes is not of the type that the topic announces"))
            .fix("build driver and message packages from the same release of ROS"),
        false => Finding::error(CHECK, format!("{name} has a publisher, but nothing comes"))
            .fix("look whether the driver waits for its device (ros2 topic hz TOPIC on its machine); where raw pictures are lost, raise the receive buffers (see buffers) or publish /compressed"),
    };
    finding.because("without frames nothing is predicted")
}

/// One line for what works.
fn summary(name: &str, camera: &Camera, stream: &Stream) -> Finding {
    let size = match camera.pictures.iter().flatten().next() {
        Some(Picture {
            size: (width, height),
            ..
        }) => format!("{width}x{height} "),
        None => String::new(),
    };
    let encoding = camera
        .encoding
        .as_deref()
        .map(of_others)
        .unwrap_or_default();
    let rate = match stream.timeline.period_s() {
        Some(period_s) => hertz(Duration::from_secs_f64(period_s)),
        None => format!("{} frames", stream.timeline.len()),
    };
    let delay = match stream.timeline.delay_s() {
        Some(delay_s) if (0.0..CLOCKS_DIFFER_S).contains(&delay_s) => {
            format!(
                ", heard {} after capture",
                rough(Duration::from_secs_f64(delay_s))
            )
        }
        _ => String::new(),
    };
    let frames: Vec<_> = stream
        .frame_ids
        .iter()
        .map(|frame| of_others(frame))
        .collect();
    Finding::ok(
        CHECK,
        format!(
            "{name}: {size}{encoding}, {rate}{delay}, frame_id \"{}\"",
            frames.join("\", \"")
        ),
    )
}

fn pictures(name: &str, camera: &Camera) -> Vec<Finding> {
    if let Some(Err(reason)) = camera.pictures.iter().find(|picture| picture.is_err()) {
        return vec![
            Finding::error(CHECK, format!("{name}: {}", of_others(reason)))
                .because("the encoder drops such frames")
                .fix("have the driver publish rgb8 or bgr8, or jpeg on /compressed; for a depth camera, name the colour camera with --camera"),
        ];
    }
    let pictures = || camera.pictures.iter().flatten();
    let count = pictures().count().max(1) as f64;
    let mean = pictures().map(|picture| picture.mean).sum::<f64>() / count;
    let spread = pictures().map(|picture| picture.spread).sum::<f64>() / count;
    let is_blank = pictures().next().is_some() && (mean < DARK || spread < FLAT);
    let finding = || {
        Finding::warning(CHECK, format!("{name}: the pictures show nothing: mean {mean:.2}, spread {spread:.3} (0 black, 1 white)"))
            .because("a picture of one colour has no future to predict")
            .fix("remove the lens cap, switch the light on, or look at exposure and gain")
    };
    is_blank.then(finding).into_iter().collect()
}

/// Whether the camera that the nodes would use has stopped, or is published faster than it takes pictures.
pub(crate) fn repeats(heard: &Heard, wanted: Option<&str>) -> Option<Finding> {
    let (name, camera) = heard.camera(wanted)?;
    repeats_of(&of_others(name), camera.best()?)
}

fn repeats_of(name: &str, stream: &Stream) -> Option<Finding> {
    let timeline = &stream.timeline;
    let repeat_s = timeline.longest_repeat_s();
    if repeat_s > FROZEN_AFTER_S {
        return Some(
            Finding::error(CHECK, format!("{name}: the picture was the same, byte for byte, for {repeat_s:.1} s: the camera has stopped"))
                .because("a live picture has noise; the planner publishes no plan from a camera that has stopped")
                .fix("start the camera's driver again; for a simulator that renders without noise, frozen_after:=0.0 on the encoder"),
        );
    }
    let (period_s, picture_s) = (timeline.period_s()?, timeline.picture_period_s()?);
    let rate = |period_s| hertz(Duration::from_secs_f64(period_s));
    (picture_s > 1.2 * period_s).then(|| {
        Finding::warning(
            CHECK,
            format!(
                "{name}: publishes {}, but only {} of new pictures: the others are repeated",
                rate(period_s),
                rate(picture_s)
            ),
        )
        .because("the model steps by the pictures that the camera takes, not by their copies")
        .fix("set the driver's rate to that of the camera, or shorten its exposure")
    })
}

/// Times that no node accepts.
pub(crate) fn bad_times(name: &str, stream: &Stream) -> Option<Finding> {
    let count = stream.bad_times;
    let finding = || {
        let what =
            format!("{name}: {count} messages have a time with nanosec of 1000000000 or more");
        Finding::error(CHECK, what)
            .because("the nodes drop such messages")
            .fix("have the publisher carry whole seconds over to sec")
    };
    (count > 0).then(finding)
}

/// What is wrong with the stamps.
pub(crate) fn stamps(name: &str, stream: &Stream, has_clock: bool) -> Vec<Finding> {
    let timeline = &stream.timeline;
    let unstamped = timeline.unstamped();
    if unstamped > 0 {
        return vec![
            Finding::error(
                CHECK,
                format!(
                    "{name}: {unstamped} of {} messages have no valid stamp",
                    timeline.len()
                ),
            )
            .because("frames and actions are matched by their stamps")
            .fix("have the driver stamp each message with the time of its capture"),
        ];
    }
    let mut findings: Vec<_> = bad_times(name, stream).into_iter().collect();
    let Some(delay_s) = timeline.delay_s() else {
        return findings;
    };
    let clocks = "synchronise the clocks of the machines (chrony), or stamp by the system's clock";
    let simulated = "-p use_sim_time:=true on every node: the stamps are in the time of /clock";
    if delay_s < -REFUSED_S {
        findings.push(
            Finding::error(
                CHECK,
                format!(
                    "{name}: stamps are {:.2} s ahead of this machine's clock",
                    -delay_s
                ),
            )
            .because("the nodes drop messages with stamps more than 0.1 s ahead (bad_stamp)")
            .fix(if has_clock { simulated } else { clocks }),
        );
    } else if delay_s < -AHEAD_S {
        findings.push(
            Finding::warning(CHECK, format!("{name}: stamps are {:.0} ms ahead of this machine's clock", -delay_s * 1e3))
                .because("latencies are measured too short, and frames are matched with actions of another moment")
                .fix(clocks),
        );
    } else if delay_s > CLOCKS_DIFFER_S {
        findings.push(
            Finding::warning(CHECK, format!("{name}: stamps are {delay_s:.0} s old"))
                .because("plans from frames older than max_age are not sent, and latencies are meaningless")
                .fix(match has_clock {
                    true => simulated,
                    false => "play bags with --restamp (player: restamp:=true); for a driver, stamp with the time of capture",
                }),
        );
    } else if delay_s > LATE_S {
        findings.push(
            Finding::warning(CHECK, format!("{name}: heard {delay_s:.1} s after capture"))
                .because("whatever is predicted or planned is late by that")
                .fix("publish /compressed, a smaller size or a lower rate; look for a slow network or a busy machine"),
        );
    }
    let backwards = timeline.backwards();
    if backwards > 0 {
        findings.push(
            Finding::warning(
                CHECK,
                format!(
                    "{name}: {backwards} messages are stamped before the one that came before them"
                ),
            )
            .because("they are dropped as out of order, or taken for a new recording")
            .fix("one publisher for each topic; a driver that stamps at capture"),
        );
    }
    if let Some(jitter) = timeline.jitter().filter(|jitter| *jitter > UNEVEN) {
        findings.push(
            Finding::warning(CHECK, format!("{name}: uneven stamps: a tenth of the gaps is at least {jitter:.1} times the median"))
                .because("frames are looked for within a quarter of a frame period")
                .fix("stamp with the time of capture and not of publishing; fix exposure time and rate of the camera"),
        );
    }
    findings
}

/// What is wrong with how it comes.
fn transport(name: &str, stream: &Stream) -> Vec<Finding> {
    let mut findings = Vec::new();
    let came = stream.timeline.len() as f64;
    let share = stream.lost as f64 / (came + stream.lost as f64).max(1.0);
    if share > LOST {
        findings.push(
            Finding::warning(CHECK, format!("{name}: {} frames were lost ({:.0} %)", stream.lost, 100.0 * share))
                .because("a context with a frame missing gives no prediction")
                .fix("raise the receive buffers (see buffers), publish /compressed, or use a cable in place of radio"),
        );
    }
    if stream.publishers.len() > 1 || stream.frame_ids.len() > 1 {
        findings.push(
            Finding::warning(
                CHECK,
                format!(
                    "{name}: {} publishers, {} frame_ids",
                    stream.publishers.len(),
                    stream.frame_ids.len()
                ),
            )
            .because("the nodes keep to one camera and drop frames of the other (wrong_frame)")
            .fix("one topic for each camera: remap one of the drivers"),
        );
    } else if stream.frame_ids.iter().any(String::is_empty) {
        findings.push(
            Finding::note(CHECK, format!("{name}: the frame_id is empty"))
                .because("cameras are told apart by it")
                .fix("set the driver's parameter for it (frame_id, camera_frame_id)"),
        );
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Level, timeline::regular};
    use image::RgbImage;
    use wm_msgs::builtin_interfaces::Time;
    use wm_ros::Qos;

    fn stream(count: u64, period_ms: u64, delay_ms: i64) -> Stream {
        Stream {
            timeline: regular(count, period_ms, delay_ms),
            publishers: vec![Qos::sensor_data()],
            frame_ids: ["camera".to_owned()].into(),
            ..Stream::default()
        }
    }

    fn camera(stream: Stream) -> Camera {
        let pixels = RgbImage::from_fn(8, 8, |x, _| image::Rgb([(x * 30) as u8; 3]));
        Camera {
            raw: Some(stream),
            pictures: vec![Ok(Picture::of(pixels))],
            encoding: Some("rgb8".into()),
            ..Camera::default()
        }
    }

    fn heard(camera: Camera) -> Heard {
        let mut heard = Heard::default();
        heard.cameras.insert(DEFAULT_CAMERA.into(), camera);
        heard
    }

    fn levels(heard: &Heard) -> Vec<Level> {
        check(heard, None)
            .iter()
            .map(|finding| finding.level)
            .collect()
    }

    fn worst(stream: Stream) -> String {
        let findings = check(&heard(camera(stream)), None);
        let worst = findings
            .into_iter()
            .max_by_key(|finding| finding.level)
            .unwrap();
        format!("{:?}: {}", worst.level, worst.what)
    }

    #[test]
    fn topics_of_other_transports_are_named() {
        let heard = Heard {
            unread: vec!["/camera/ffmpeg is compressed video".to_owned()],
            ..Heard::default()
        };
        let findings = check(&heard, None);
        assert_eq!(findings.len(), 2, "{findings:?}");
        assert!(format!("{findings:?}").contains("/camera/ffmpeg is compressed video"));
    }

    #[test]
    fn invalid_times_are_an_error_of_the_driver() {
        let some = Stream {
            bad_times: 3,
            ..stream(30, 200, 12)
        };
        let all = Stream {
            bad_times: 3,
            ..stream(0, 200, 12)
        };
        for stream in [some, all] {
            let worst = worst(stream);
            assert!(
                worst.contains("3 messages have a time with nanosec"),
                "{worst}"
            );
        }
    }

    #[test]
    fn a_good_camera_is_one_line() {
        let found = check(&heard(camera(stream(30, 200, 12))), None);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(
            found[0].what,
            "/camera/image_raw: 8x8 rgb8, 5 Hz, heard 12 ms after capture, frame_id \"camera\""
        );
    }

    #[test]
    fn no_camera_or_a_silent_one_is_an_error() {
        assert_eq!(levels(&Heard::default()), [Level::Error]);
        assert_eq!(levels(&heard(camera(Stream::default()))), [Level::Error]);
        let named = &check(&heard(camera(stream(9, 200, 0))), Some("/front"))[0];
        assert!(
            named.what.contains("there are /camera/image_raw"),
            "{named:?}"
        );
    }

    #[test]
    fn stamps_are_held_against_the_clock() {
        assert!(worst(stream(9, 200, -20_000)).starts_with("Error"));
        assert!(worst(stream(9, 200, -1_200)).contains("stamps are 1.20 s ahead"));
        assert!(
            worst(stream(9, 200, -60))
                .starts_with("Warning: /camera/image_raw: stamps are 60 ms ahead")
        );
        assert!(worst(stream(9, 200, 60_000)).contains("60 s old"));
        assert!(worst(stream(9, 200, 900)).contains("0.9 s after capture"));
        let mut none = stream(9, 200, 0);
        none.timeline.0[4].stamp = Some(Time::default());
        assert!(worst(none).contains("1 of 9 messages have no valid stamp"));
    }

    #[test]
    fn a_simulators_time_is_told_from_a_wrong_clock() {
        let old = stream(9, 200, 60_000);
        let fix = |has_clock| stamps("/c", &old, has_clock)[0].fix.clone().unwrap();
        assert!(fix(true).contains("use_sim_time") && fix(false).contains("restamp"));
    }

    #[test]
    fn lost_frames_and_second_cameras_are_seen() {
        let mut lossy = stream(90, 33, 10);
        lossy.lost = 10;
        assert!(worst(lossy).contains("10 frames were lost (10 %)"));
        let mut two = stream(9, 200, 0);
        two.frame_ids.insert("other".into());
        assert!(worst(two).contains("2 frame_ids"));
    }

    #[test]
    fn stopped_and_repeating_cameras_are_named() {
        let repeated = |times: u64| {
            let mut stream = stream(180, 33, 10);
            for arrival in &mut stream.timeline.0 {
                arrival.fingerprint = arrival.fingerprint.map(|picture| picture / times);
            }
            let finding = repeats(&heard(camera(stream)), None).unwrap();
            format!("{:?}: {}", finding.level, finding.what)
        };
        let twice = repeated(2);
        assert!(
            twice.starts_with("Warning: /camera/image_raw: publishes 30 Hz, but only 15 Hz"),
            "{twice}"
        );
        let stopped = repeated(1000);
        assert!(
            stopped.starts_with("Error") && stopped.contains("the camera has stopped"),
            "{stopped}"
        );
    }

    #[test]
    fn what_is_no_picture_or_shows_nothing_is_said() {
        let mut depth = camera(stream(9, 200, 0));
        depth.pictures = vec![Err("encoding \"16UC1\" is not supported".into())];
        assert_eq!(levels(&heard(depth)), [Level::Ok, Level::Error]);
        let mut dark = camera(stream(9, 200, 0));
        dark.pictures = vec![Ok(Picture::of(RgbImage::new(4, 4)))];
        assert_eq!(levels(&heard(dark)), [Level::Ok, Level::Warning]);
    }

    #[test]
    fn what_peers_say_cannot_write_on_the_terminal() {
        let mut evil = stream(9, 200, 0);
        evil.frame_ids = ["\u{1b}[2J".to_owned()].into();
        assert!(!check(&heard(camera(evil)), None)[0].what.contains('\u{1b}'));
    }
}

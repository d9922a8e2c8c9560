//! Checks of the camera: messages, rate, stamps, pictures.

use crate::{Camera, Finding, Picture, Stream, Survey, survey::DEFAULT_CAMERA};
use std::time::Duration;
use wm_model_nodes::cadence::{hertz, rough};
use wm_ros::logging::of_others;

const CHECK: &str = "camera";
/// A longer delay cannot come from a pipeline \[s\].
const CLOCKS_DIFFER_S: f64 = 10.0;
/// The nodes refuse stamps further ahead \[s\].
const REFUSED_S: f64 = 0.1;
/// Synchronised clocks differ by less \[s\].
const AHEAD_S: f64 = 0.02;
/// An older frame is of little use: planning takes as long \[s\].
const LATE_S: f64 = 0.5;
/// The largest acceptable share of lost frames.
const LOST: f64 = 0.02;
/// The largest acceptable ratio of the longest tenth of the gaps to the median: nodes search frames within a quarter of
/// a period.
const UNEVEN: f64 = 1.25;
/// A live camera does not repeat a picture for longer: the encoder's default of `frozen_after` \[s\].
const FROZEN_AFTER_S: f64 = 1.0;
/// Mean and spread below which a picture shows nothing, of values from 0 to 1.
const DARK: f64 = 0.04;
/// See [`DARK`].
const FLAT: f64 = 0.01;

/// The findings about the camera that the nodes would use, and a note about others.
pub(crate) fn check(survey: &Survey, wanted: Option<&str>) -> Vec<Finding> {
    let Some((name, camera)) = survey.camera(wanted) else {
        let unread = survey.unread.iter();
        let unread = unread.map(|advice| Finding::note(CHECK, advice.clone()));
        return [absent(survey, wanted)].into_iter().chain(unread).collect();
    };
    let shown = of_others(name);
    let Some(stream) = camera.best().filter(|stream| !stream.timeline.is_empty()) else {
        return vec![silent(&shown, camera)];
    };
    let mut findings = vec![summary(&shown, camera, stream)];
    findings.extend(pictures(&shown, camera));
    findings.extend(stamps(&shown, stream, survey.clock_ns.is_some()));
    findings.extend(transport(&shown, stream));
    let others: Vec<_> = survey
        .cameras
        .keys()
        .filter(|other| *other != name)
        .map(|other| of_others(other))
        .collect();
    if !others.is_empty() {
        findings.push(
            Finding::note(CHECK, format!("other cameras: {}", others.join(", ")))
                .because("a set of nodes uses one camera")
                .fix("use camera:=TOPIC with wm launch, or check it with wm doctor --camera TOPIC"),
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

fn absent(survey: &Survey, wanted: Option<&str>) -> Finding {
    let finding = match wanted {
        Some(name) => {
            let others: Vec<_> = survey.cameras.keys().map(|name| of_others(name)).collect();
            let others = match others.is_empty() {
                true => "there are no image topics".to_owned(),
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
        .because("without frames there are no predictions")
        .fix("start the camera's driver; if it runs, check its domain, and that it is on this host or reached by --interface")
}

fn silent(name: &str, camera: &Camera) -> Finding {
    let undecodable = camera
        .streams()
        .find_map(|stream| stream.first_undecodable.as_ref());
    let finding = match undecodable {
        Some(reason) => Finding::error(CHECK, format!("{name}: no message can be decoded as the type of the topic: {reason}"))
            .fix("build driver and message packages from the same release of ROS; stamps have a nanosec below 1000000000"),
        None => Finding::error(CHECK, format!("{name} has a publisher, but no message arrives"))
            .fix("check whether the driver waits for its device (ros2 topic hz TOPIC on its machine); if raw pictures are lost, raise the receive buffers (see buffers) or publish /compressed"),
    };
    finding.because("without frames there are no predictions")
}

/// One line for a working camera.
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
                ", {} after capture",
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
                .fix("let the driver publish rgb8 or bgr8, or jpeg on /compressed; for a depth camera, name the colour camera with --camera"),
        ];
    }
    let pictures = || camera.pictures.iter().flatten();
    let count = pictures().count().max(1) as f64;
    let mean = pictures().map(|picture| picture.mean).sum::<f64>() / count;
    let spread = pictures().map(|picture| picture.spread).sum::<f64>() / count;
    let is_blank = pictures().next().is_some() && (mean < DARK || spread < FLAT);
    let finding = || {
        Finding::warning(CHECK, format!("{name}: the pictures show nothing: mean {mean:.2}, spread {spread:.3} (0 black, 1 white)"))
            .because("a picture of one colour cannot be predicted")
            .fix("remove the lens cap, switch the light on, or check exposure and gain")
    };
    is_blank.then(finding).into_iter().collect()
}

/// Whether the camera has stopped, or is published faster than it takes pictures.
pub(crate) fn repeats(survey: &Survey, wanted: Option<&str>) -> Option<Finding> {
    let (name, camera) = survey.camera(wanted)?;
    repeats_of(&of_others(name), camera.best()?)
}

fn repeats_of(name: &str, stream: &Stream) -> Option<Finding> {
    let timeline = &stream.timeline;
    let repeat_s = timeline.longest_repeat_s();
    if repeat_s > FROZEN_AFTER_S {
        return Some(
            Finding::error(CHECK, format!("{name}: the picture was the same, byte for byte, for {repeat_s:.1} s: the camera has stopped"))
                .because("a live picture has noise; the planner publishes no plan if the camera has stopped")
                .fix("start the camera's driver again; for a simulator that renders without noise, frozen_after:=0.0 on the encoder"),
        );
    }
    let (period_s, picture_s) = (timeline.period_s()?, timeline.picture_period_s()?);
    let rate = |period_s| hertz(Duration::from_secs_f64(period_s));
    (picture_s > 1.2 * period_s).then(|| {
        Finding::warning(
            CHECK,
            format!(
                "{name}: publishes {}, but only {} of new pictures: the rest are repeats",
                rate(period_s),
                rate(picture_s)
            ),
        )
        .because("the model needs new pictures, not copies")
        .fix("set the driver's rate to that of the camera, or shorten its exposure")
    })
}

/// Faults of the stamps.
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
            .fix("let the driver stamp each message with its capture time"),
        ];
    }
    let mut findings = Vec::new();
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
                .because("measured latencies are too short, and frames are matched with actions of another time")
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
            Finding::warning(CHECK, format!("{name}: arrives {delay_s:.1} s after capture"))
                .because("all predictions and plans are late by as much")
                .fix("publish /compressed, a smaller size or a lower rate; check for a slow network or a busy machine"),
        );
    }
    let backwards = timeline.backwards();
    if backwards > 0 {
        findings.push(
            Finding::warning(
                CHECK,
                format!(
                    "{name}: {backwards} messages have an earlier stamp than their predecessor"
                ),
            )
            .because("they are dropped as out of order, or treated as a new recording")
            .fix("one publisher for each topic; a driver that stamps at capture"),
        );
    }
    if let Some(jitter) = timeline.jitter().filter(|jitter| *jitter > UNEVEN) {
        findings.push(
            Finding::warning(CHECK, format!("{name}: uneven stamps: a tenth of the gaps is at least {jitter:.1} times the median"))
                .because("the nodes search frames within a quarter of a frame period")
                .fix("stamp at capture, not at publishing; fix exposure time and rate of the camera"),
        );
    }
    findings
}

/// Faults of the transport.
fn transport(name: &str, stream: &Stream) -> Vec<Finding> {
    let mut findings = Vec::new();
    let came = stream.timeline.len() as f64;
    let share = stream.lost as f64 / (came + stream.lost as f64).max(1.0);
    if share > LOST {
        findings.push(
            Finding::warning(CHECK, format!("{name}: {} frames were lost ({:.0} %)", stream.lost, 100.0 * share))
                .because("an incomplete context gives no prediction")
                .fix("raise the receive buffers (see buffers), publish /compressed, or use a cable instead of radio"),
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
            .because("the nodes use one camera and drop the other's frames (wrong_frame)")
            .fix("one topic for each camera: remap one of the drivers"),
        );
    } else if stream.frame_ids.iter().any(String::is_empty) {
        findings.push(
            Finding::note(CHECK, format!("{name}: the frame_id is empty"))
                .because("it distinguishes cameras")
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

    fn survey(camera: Camera) -> Survey {
        let mut survey = Survey::default();
        survey.cameras.insert(DEFAULT_CAMERA.into(), camera);
        survey
    }

    fn levels(survey: &Survey) -> Vec<Level> {
        check(survey, None)
            .iter()
            .map(|finding| finding.level)
            .collect()
    }

    fn worst(stream: Stream) -> String {
        let findings = check(&survey(camera(stream)), None);
        let worst = findings
            .into_iter()
            .max_by_key(|finding| finding.level)
            .unwrap();
        format!("{:?}: {}", worst.level, worst.what)
    }

    #[test]
    fn topics_of_other_transports_are_named() {
        let survey = Survey {
            unread: vec!["/camera/ffmpeg is compressed video".to_owned()],
            ..Survey::default()
        };
        let findings = check(&survey, None);
        assert_eq!(findings.len(), 2, "{findings:?}");
        assert!(format!("{findings:?}").contains("/camera/ffmpeg is compressed video"));
    }

    #[test]
    fn a_good_camera_is_one_line() {
        let found = check(&survey(camera(stream(30, 200, 12))), None);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(
            found[0].what,
            "/camera/image_raw: 8x8 rgb8, 5 Hz, 12 ms after capture, frame_id \"camera\""
        );
    }

    #[test]
    fn missing_or_silent_camera_is_an_error() {
        assert_eq!(levels(&Survey::default()), [Level::Error]);
        assert_eq!(levels(&survey(camera(Stream::default()))), [Level::Error]);
        let named = &check(&survey(camera(stream(9, 200, 0))), Some("/front"))[0];
        assert!(
            named.what.contains("there are /camera/image_raw"),
            "{named:?}"
        );
    }

    #[test]
    fn stamps_are_compared_with_the_clock() {
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
    fn simulated_time_differs_from_a_wrong_clock() {
        let old = stream(9, 200, 60_000);
        let fix = |has_clock| stamps("/c", &old, has_clock)[0].fix.clone().unwrap();
        assert!(fix(true).contains("use_sim_time") && fix(false).contains("restamp"));
    }

    #[test]
    fn lost_frames_and_second_cameras_are_reported() {
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
            let finding = repeats(&survey(camera(stream)), None).unwrap();
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
    fn undecodable_and_blank_pictures_are_reported() {
        let mut depth = camera(stream(9, 200, 0));
        depth.pictures = vec![Err("encoding \"16UC1\" is not supported".into())];
        assert_eq!(levels(&survey(depth)), [Level::Ok, Level::Error]);
        let mut dark = camera(stream(9, 200, 0));
        dark.pictures = vec![Ok(Picture::of(RgbImage::new(4, 4)))];
        assert_eq!(levels(&survey(dark)), [Level::Ok, Level::Warning]);
    }

    #[test]
    fn texts_of_peers_are_escaped() {
        let mut evil = stream(9, 200, 0);
        evil.frame_ids = ["\u{1b}[2J".to_owned()].into();
        assert!(
            !check(&survey(camera(evil)), None)[0]
                .what
                .contains('\u{1b}')
        );
    }
}

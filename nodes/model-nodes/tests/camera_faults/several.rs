//! The node views before two cameras, one of which stops and returns.

use std::{collections::BTreeMap, time::Duration};

use image::{Rgb, RgbImage};
use tokio::time::{Instant, Interval};
use wm_camera::image_message::{decode_image, encode_image, encode_jpeg};
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::{DiagnosticArray, DiagnosticStatus},
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
};
use wm_ros::{Context, Node, NodeArgs, Publisher, Qos, Subscription};

use crate::running::{PATIENCE, model::write_model_of_views, with_nodes};

/// From one frame to the next.
const PERIOD: Duration = Duration::from_millis(50);
/// How long after the first camera's the second one's frames are taken \[ns\].
const OFFSET_NS: i64 = 10_000_000;

/// The cameras, and all that the node publishes.
struct Cameras {
    ticks: Interval,
    begin_ns: i64,
    index: i64,
    front: Publisher<Image>,
    wrist: Publisher<CompressedImage>,
    pictures: Subscription<Image>,
    diagnostics: Subscription<DiagnosticArray>,
    newest: Option<Image>,
    statuses: BTreeMap<String, DiagnosticStatus>,
    node: Node,
}

impl Cameras {
    async fn new(context: &Context) -> Self {
        let args = NodeArgs::parse(Vec::<String>::new()).unwrap();
        let node = Node::new(context, "world", wm_ros::NAMESPACE, &args).unwrap();
        let many = Qos::reliable(1000);
        let mut cameras = Self {
            ticks: tokio::time::interval(PERIOD),
            begin_ns: 0,
            index: 0,
            front: node.publisher("/front/image_raw", many).unwrap(),
            wrist: node.publisher("/wrist/image_raw/compressed", many).unwrap(),
            pictures: node.subscription("views/image_raw", many).unwrap(),
            diagnostics: node.subscription("/diagnostics", many).unwrap(),
            newest: None,
            statuses: BTreeMap::new(),
            node,
        };
        let met = async {
            cameras.front.wait_for_subscribers(1).await;
            cameras.wrist.wait_for_subscribers(1).await;
            cameras.pictures.wait_for_publishers(1).await;
            cameras.diagnostics.wait_for_publishers(1).await;
        };
        tokio::time::timeout(PATIENCE, met)
            .await
            .expect("the nodes did not meet");
        (cameras.ticks, cameras.begin_ns) =
            (tokio::time::interval(PERIOD), cameras.node.now().to_nanos());
        cameras
    }

    /// A frame of each camera; takes what the node has published. Gives the first camera's stamp.
    async fn moment(&mut self, has_wrist: bool) -> Time {
        self.ticks.tick().await;
        // Never ahead of the clock.
        let now_ns = self.begin_ns + (self.index - 1) * i64::try_from(PERIOD.as_nanos()).unwrap();
        let header = |frame_id: &str, stamp_ns| Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: frame_id.into(),
        };
        let blue = self.index as u8;
        let picture = |width, red| RgbImage::from_pixel(width, 48, Rgb([red, 0, blue]));
        let front = encode_image(&picture(64, 200), header("front", now_ns));
        self.front.publish(&front).unwrap();
        if has_wrist {
            let header = header("wrist", now_ns + OFFSET_NS);
            let wrist = encode_jpeg(&picture(80, 40), header, 95).unwrap();
            self.wrist.publish(&wrist).unwrap();
        }
        self.index += 1;
        while let Some(received) = self.pictures.try_recv() {
            self.newest = Some(received.message);
        }
        while let Some(received) = self.diagnostics.try_recv() {
            let statuses = received.message.status.into_iter();
            let statuses = statuses.map(|status| (status.name.clone(), status));
            self.statuses.extend(statuses);
        }
        front.header.stamp
    }

    async fn until(&mut self, what: &str, has_wrist: bool, is_so: impl Fn(&Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !is_so(self) {
            assert!(Instant::now() < end, "{what}: {:#?}", self.statuses);
            self.moment(has_wrist).await;
        }
    }

    /// Until a picture of a moment from now on comes.
    async fn pictures_come(&mut self) -> Image {
        let stamp = self.moment(true).await;
        self.until("a picture", true, |cameras| {
            cameras.newest_stamp() >= Some(stamp)
        })
        .await;
        self.newest.clone().unwrap()
    }

    fn newest_stamp(&self) -> Option<Time> {
        self.newest.as_ref().map(|image| image.header.stamp)
    }

    /// A figure of the node's own status.
    fn value(&self, key: &str) -> Option<&str> {
        let mut values = self.statuses.get("wm/views")?.values.iter();
        let found = values.find(|pair| pair.key == key)?;
        Some(&found.value)
    }
}

#[test]
fn one_of_two_cameras_stops_and_returns() {
    let folder = tempfile::tempdir().unwrap();
    write_model_of_views(folder.path(), 2);
    let parameters = format!(
        "-p model:={} -p cameras:=[/front/image_raw,/wrist/image_raw]",
        folder.path().display()
    );
    let nodes = [(&wm_model_nodes::views::NODE, parameters)];
    with_nodes(&nodes, async |here| {
        let mut cameras = Cameras::new(here).await;
        let joined = cameras.pictures_come().await;
        assert_eq!(joined.header.frame_id, "front");
        let picture = decode_image(&joined).unwrap();
        assert_eq!(picture.dimensions(), (32, 32));
        assert_eq!(picture[(8, 16)].0[0], 200);
        assert!(picture[(24, 16)].0[0].abs_diff(40) < 4);

        let name = "wm/views: input images of camera 2";
        let is_named = |cameras: &Cameras| {
            let status = cameras.statuses.get(name);
            status.is_some_and(|status| {
                status.level == DiagnosticStatus::ERROR
                    && status.message.contains("/wrist/image_raw")
            })
        };
        let stopped = cameras.moment(false).await;
        cameras.until(name, false, is_named).await;
        assert!(
            cameras.newest_stamp() < Some(stopped),
            "no picture of one camera"
        );
        let is_counted = |cameras: &Cameras| {
            let count = cameras.value("frames dropped, /front/image_raw [total]");
            count.is_some_and(|count| count.parse::<u64>().unwrap() > 5)
        };
        cameras.until("drops", false, is_counted).await;
        let status = &cameras.statuses["wm/views"];
        assert!(status.message.contains("/wrist/image_raw"), "{status:?}");
        let key = "stamp after the first camera's, /wrist/image_raw [ms]";
        assert_eq!(cameras.value(key), Some("10.0"));

        cameras.pictures_come().await;
        let is_well = |cameras: &Cameras| {
            let status = cameras.statuses.get("wm/views");
            status.is_some_and(|status| status.level == DiagnosticStatus::OK)
        };
        cameras.until("all is well", true, is_well).await;
    });
}

//! Points tracked through a video.

use image::RgbImage;

use crate::onnx::features::other;
use crate::onnx::input::{size_of, text};
use crate::onnx::{Network, Output, Result, Role, Tensor};

/// Longest video and most points of a run: a tracker keeps everything in memory.
const MAX_STEPS: usize = 1024;
const MAX_QUERIES: usize = 4096;

/// A network that tracks points: `tracks`.
#[derive(Debug)]
pub struct Tracks {
    network: Network,
    places: usize,
    visibilities: usize,
    visible_above: f32,
}

/// A point to track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Index of the picture with this position.
    pub step: usize,
    /// Pixels from the centre of the leftmost pixels.
    pub x: f32,
    /// Pixels from the centre of the topmost pixels.
    pub y: f32,
}

/// A point in one picture of the video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// Pixels from the centre of the leftmost pixels; may lie outside the picture.
    pub x: f32,
    /// Pixels from the centre of the topmost pixels.
    pub y: f32,
    /// Visibility on the network's own scale.
    pub visibility: f32,
    /// Whether it exceeds `visible_above`.
    pub visible: bool,
}

impl Tracks {
    pub(crate) fn new(network: Network) -> Result<Self> {
        if network.role() != Role::Tracks {
            return Err(other(&network, "tracks"));
        }
        let spec = network.spec();
        let places = network.index_of(&spec.output, "output")?;
        let visibility = spec.visibility.clone().unwrap_or(Output::Index(1));
        let visibilities = network.index_of(&visibility, "visibility")?;
        let visible_above = spec.visible_above.unwrap_or(0.5);
        network.takes(2, "the video, then the queries")?;
        Ok(Self {
            places,
            visibilities,
            visible_above,
            network,
        })
    }

    /// The network, for reports.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// One track per query, in order, with one point per picture of the video. All pictures must have one size.
    ///
    /// The network gets a video `1 x T x 3 x H x W` (or by its layout) and queries `1 x N x 3` of step, x and y in
    /// pixels of its own picture. Positions are converted so that pixel centres stay pixel centres, as in the resize.
    pub fn follow(&self, video: &[RgbImage], queries: &[Query]) -> Result<Vec<Vec<TrackPoint>>> {
        let network = &self.network;
        let (Some(first), false) = (video.first(), queries.is_empty()) else {
            return Ok(vec![Vec::new(); queries.len()]);
        };
        let from = size_of(first);
        self.check(video, queries, from)?;
        let prepared: Vec<_> = video
            .iter()
            .map(|picture| network.prepare(picture))
            .collect::<Result<_>>()?;
        let to = prepared.first().map_or(from, |picture| picture.size);
        let scale = Scale::new(from, to);
        let numbers = queries.iter().flat_map(|query| {
            let (x, y) = scale.forth(query.x, query.y);
            // Exact: a step is below MAX_STEPS.
            [query.step as f32, x, y]
        });
        let points = Tensor::new(vec![1, queries.len(), 3], numbers.collect());
        let points =
            points.ok_or_else(|| self.wrong_queries(format!("{} numbers", queries.len())))?;
        let outputs = network.run(&[network.arrange(&prepared, Some(video.len()))?, points])?;
        let (steps, count) = (video.len(), queries.len());
        let places = self.output(&outputs, self.places, "output", &[1, steps, count, 2])?;
        let visibilities = self.output(
            &outputs,
            self.visibilities,
            "visibility",
            &[1, steps, count],
        )?;

        let mut tracks = vec![Vec::with_capacity(steps); count];
        let (places, _) = places.as_chunks::<2>();
        for (places, visibilities) in places
            .chunks_exact(count)
            .zip(visibilities.chunks_exact(count))
        {
            for ((track, [x, y]), visibility) in tracks.iter_mut().zip(places).zip(visibilities) {
                let (x, y) = scale.back(*x, *y);
                track.push(TrackPoint {
                    x,
                    y,
                    visibility: *visibility,
                    visible: *visibility > self.visible_above,
                });
            }
        }
        Ok(tracks)
    }

    fn check(&self, video: &[RgbImage], queries: &[Query], size: [usize; 2]) -> Result<()> {
        let network = &self.network;
        if video.len() > MAX_STEPS {
            let expected = format!("at most {MAX_STEPS}");
            return Err(network.wrong("pictures of a video", expected, video.len().to_string()));
        }
        if let Some(other) = video.iter().find(|picture| size_of(picture) != size) {
            return Err(network.wrong(
                "picture of a video (width x height)",
                text(size),
                text(size_of(other)),
            ));
        }
        if queries.len() > MAX_QUERIES {
            return Err(self.wrong_queries(format!("{} of them", queries.len())));
        }
        let off = |query: &&Query| {
            query.step >= video.len() || !query.x.is_finite() || !query.y.is_finite()
        };
        match queries.iter().find(off) {
            Some(query) => {
                Err(self.wrong_queries(format!("{query:?} in {} pictures", video.len())))
            }
            None => Ok(()),
        }
    }

    fn wrong_queries(&self, found: String) -> crate::onnx::Error {
        let expected = format!("at most {MAX_QUERIES}, each of a step of the video and a place");
        self.network.wrong("queries", expected, found)
    }

    /// An output of `shape`, or with further axes of one element.
    fn output<'a>(
        &self,
        outputs: &'a [Tensor],
        index: usize,
        key: &str,
        shape: &[usize],
    ) -> Result<&'a [f32]> {
        let found = outputs.get(index);
        let other = found.map_or(&[][..], Tensor::shape);
        let fits = |tensor: &&Tensor| {
            tensor.shape().starts_with(shape)
                && tensor
                    .shape()
                    .iter()
                    .skip(shape.len())
                    .all(|side| *side == 1)
        };
        found.filter(fits).map(Tensor::data).ok_or_else(|| {
            self.network
                .shape_error(key, format!("{shape:?}"), format!("{other:?}"))
        })
    }
}

/// Positions in the given picture and in the network's picture.
struct Scale {
    across: f32,
    down: f32,
}

impl Scale {
    fn new(from: [usize; 2], to: [usize; 2]) -> Self {
        let ([from_height, from_width], [height, width]) = (from, to);
        Self {
            across: width as f32 / from_width as f32,
            down: height as f32 / from_height as f32,
        }
    }

    fn forth(&self, x: f32, y: f32) -> (f32, f32) {
        ((x + 0.5) * self.across - 0.5, (y + 0.5) * self.down - 0.5)
    }

    fn back(&self, x: f32, y: f32) -> (f32, f32) {
        ((x + 0.5) / self.across - 0.5, (y + 0.5) / self.down - 0.5)
    }
}

//! How a camera's picture becomes the picture that a model takes: one rule for data, nodes and evaluation.

mod part;
mod picture_size;

use std::{fmt, str::FromStr};

use candle_core::{Device, Tensor};
use image::{GenericImage as _, Rgb, RgbImage};
use serde::{Deserialize, Serialize};

pub use part::Part;
pub use picture_size::PictureSize;

use crate::{Error, Result};

/// Colour of the bars beside a padded picture: black.
pub const BARS: Rgb<u8> = Rgb([0; 3]);

/// What happens to a picture whose aspect is not the model's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// Width and height are scaled each by their own factor. Models without a rule were trained so.
    #[default]
    Stretch,
    /// The largest part of the model's aspect is cut out of the middle, and scaled.
    Crop,
    /// The whole picture is scaled to fit inside, in the middle; [`BARS`] fill the rest.
    Pad,
}

impl Fit {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Stretch, Self::Crop, Self::Pad];

    /// Its name in descriptions and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stretch => "stretch",
            Self::Crop => "crop",
            Self::Pad => "pad",
        }
    }

    /// Whether it is the rule of models that state none.
    pub fn is_stretch(&self) -> bool {
        *self == Self::Stretch
    }

    /// Which part of a picture of the size `from` becomes which part of one of the size `to`. Both are whole pixels;
    /// `None` if a size is empty.
    ///
    /// Cut and scaled sides are rounded to the nearest pixel, and an odd remainder leaves the smaller half at the left and
    /// the top.
    pub fn placement(self, from: PictureSize, to: PictureSize) -> Option<Placement> {
        if from.is_empty() || to.is_empty() {
            return None;
        }
        let whole = Placement {
            source: Part::whole(from),
            target: Part::whole(to),
        };
        Some(match self {
            Self::Stretch => whole,
            Self::Crop => Placement {
                source: Part::inside(from, to),
                ..whole
            },
            Self::Pad => Placement {
                target: Part::inside(to, from),
                ..whole
            },
        })
    }
}

impl fmt::Display for Fit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Fit {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let found = Self::ALL.into_iter().find(|fit| fit.name() == text);
        found.ok_or_else(|| format!("expected stretch, crop or pad, got {text:?}"))
    }
}

/// Which part of a camera's picture becomes which part of the model's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placement {
    /// In the camera's picture.
    pub source: Part,
    /// In the model's picture.
    pub target: Part,
}

impl Placement {
    /// The pixel of the model's picture in which pixel (`x`, `y`) of the camera's lies; `None` if it is cut off.
    pub fn pixel(&self, (x, y): (u32, u32)) -> Option<(u32, u32)> {
        let along = |at: u32, source: u32, from: u32, place: u32, to: u32| {
            let at = at.checked_sub(source).filter(|at| *at < from)?;
            // Less than `to`.
            let within = u64::from(at) * u64::from(to) / u64::from(from);
            Some(place + within as u32)
        };
        let (source, target) = (self.source, self.target);
        Some((
            along(x, source.x, source.width, target.x, target.width)?,
            along(y, source.y, source.height, target.y, target.height)?,
        ))
    }

    /// What a whole picture of the size `to` shows of the camera's: left, top, width and height in the camera's pixels.
    /// With bars it reaches beyond the camera's picture.
    pub fn view(&self, to: PictureSize) -> [f64; 4] {
        let along = |source: u32, from: u32, target: u32, place: u32, whole: u32| {
            let scale = f64::from(from) / f64::from(target);
            (
                f64::from(source) - f64::from(place) * scale,
                f64::from(whole) * scale,
            )
        };
        let (source, target) = (self.source, self.target);
        let (left, width) = along(source.x, source.width, target.width, target.x, to.width);
        let (top, height) = along(source.y, source.height, target.height, target.y, to.height);
        [left, top, width, height]
    }
}

/// How an encoder takes pictures: size, number of cameras side by side, and fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Framing {
    /// Height and width in pixels, all cameras side by side.
    pub size: (usize, usize),
    /// Cameras side by side, each in as many columns; at least 1.
    pub views: usize,
    /// What happens to pictures of another aspect.
    pub fit: Fit,
}

impl From<(usize, usize)> for Framing {
    /// One picture of this height and width, stretched.
    fn from(size: (usize, usize)) -> Self {
        Self::new(size, Fit::Stretch)
    }
}

impl Framing {
    /// One camera's picture of `size` (height, width).
    pub fn new(size: (usize, usize), fit: Fit) -> Self {
        Self {
            size,
            views: 1,
            fit,
        }
    }

    /// The size of one camera's picture.
    ///
    /// # Errors
    /// If a side is beyond 32 bits.
    pub fn view_size(&self) -> Result<PictureSize> {
        let (height, width) = (self.size.0, self.size.1 / self.views.max(1));
        let (Ok(height), Ok(width)) = (u32::try_from(height), u32::try_from(width)) else {
            return Err(fail(format!("{height}x{width} is too large")));
        };
        Ok(PictureSize { width, height })
    }

    /// `picture` as the encoder takes it. Pictures of several cameras side by side are placed one by one, unless they are
    /// stretched.
    ///
    /// # Errors
    /// If the picture or the size is empty.
    pub fn apply(&self, picture: &RgbImage) -> Result<RgbImage> {
        let from = PictureSize::of(picture);
        let views = self.apart();
        let (own, to) = views.of(from)?;
        let place = |view: u32| {
            let part = Part {
                x: view * own.width,
                ..Part::whole(own)
            };
            views.fit.place(picture, part, to)
        };
        if views.views == 1 {
            return place(0);
        }
        let count = from.width / own.width.max(1);
        let mut beside = RgbImage::new(to.width * count, to.height);
        for view in 0..count {
            paste(&mut beside, &place(view)?, (view * to.width, 0))?;
        }
        Ok(beside)
    }

    /// One picture of each camera, in the order of the training, as the encoder takes them: each placed by itself, side by
    /// side. The pictures may differ in size.
    ///
    /// # Errors
    /// If the number of pictures is not that of the cameras, the width is no multiple of it, or a picture is empty.
    pub fn join(&self, pictures: &[RgbImage]) -> Result<RgbImage> {
        let (count, views) = (pictures.len(), self.views.max(1));
        if count != views || !self.size.1.is_multiple_of(views) {
            let (height, width) = self.size;
            return Err(fail(format!(
                "{count} pictures side by side: expected {views} in {height}x{width}"
            )));
        }
        let to = self.view_size()?;
        let mut joined = RgbImage::new(to.width * (count as u32), to.height);
        for (view, picture) in (0..).zip(pictures) {
            let whole = Part::whole(PictureSize::of(picture));
            let placed = self.fit.place(picture, whole, to)?;
            paste(&mut joined, &placed, (view * to.width, 0))?;
        }
        Ok(joined)
    }

    /// The pixel of the encoder's picture in which pixel (`x`, `y`) of one of the size `from` lies; `None` if it is cut off.
    ///
    /// # Errors
    /// As [`Self::apply`].
    pub fn pixel(&self, from: PictureSize, (x, y): (u32, u32)) -> Result<Option<(u32, u32)>> {
        let views = self.apart();
        let (own, to) = views.of(from)?;
        let Some(placement) = views.fit.placement(own, to) else {
            return Err(empty(own, to));
        };
        let (view, x) = (x / own.width, x % own.width);
        Ok(placement
            .pixel((x, y))
            .map(|(x, y)| (view * to.width + x, y)))
    }

    /// The same for pictures that are placed separately: several stretched cameras are one picture.
    fn apart(self) -> Self {
        match self.fit {
            Fit::Stretch => Self { views: 1, ..self },
            _ => Self {
                views: self.views.max(1),
                ..self
            },
        }
    }

    /// The sizes of one camera's picture in one of the size `from`, and in the encoder's.
    fn of(&self, from: PictureSize) -> Result<(PictureSize, PictureSize)> {
        // No width is a multiple of so many views, so they are refused below.
        let views = u32::try_from(self.views).unwrap_or(u32::MAX);
        if !from.width.is_multiple_of(views) {
            return Err(fail(format!(
                "{from} cannot show {views} cameras side by side: the width is no multiple of {views}"
            )));
        }
        let own = PictureSize {
            width: from.width / views,
            ..from
        };
        Ok((own, self.view_size()?))
    }

    /// `picture` as the encoder takes it, scaled to 0..1: a tensor (1, H, W, 3), f32.
    ///
    /// # Errors
    /// If the picture or the size is empty.
    pub fn tensor(&self, picture: &RgbImage) -> Result<Tensor> {
        let placed = self.apply(picture)?;
        let (width, height) = placed.dimensions();
        let values: Vec<f32> = placed
            .into_raw()
            .into_iter()
            .map(|v| f32::from(v) / 255.0)
            .collect();
        let shape = (1, height as usize, width as usize, 3);
        Ok(Tensor::from_vec(values, shape, &Device::Cpu)?)
    }
}

impl Fit {
    /// The part of a picture at the size `to`.
    fn place(self, picture: &RgbImage, part: Part, to: PictureSize) -> Result<RgbImage> {
        let from = PictureSize {
            width: part.width,
            height: part.height,
        };
        let Some(Placement { source, target }) = self.placement(from, to) else {
            return Err(empty(from, to));
        };
        let source = Part {
            x: part.x + source.x,
            y: part.y + source.y,
            ..source
        };
        let scaled = source.resize(picture, (target.width, target.height))?;
        if target == Part::whole(to) {
            return Ok(scaled);
        }
        let mut padded = RgbImage::from_pixel(to.width, to.height, BARS);
        paste(&mut padded, &scaled, (target.x, target.y))?;
        Ok(padded)
    }
}

fn paste(onto: &mut RgbImage, picture: &RgbImage, (x, y): (u32, u32)) -> Result<()> {
    let copied = onto.copy_from(picture, x, y);
    copied.map_err(|error| fail(error.to_string()))
}

fn empty(from: PictureSize, to: PictureSize) -> Error {
    fail(format!(
        "cannot resize {}x{} to {}x{}: both must hold at least one pixel",
        from.height, from.width, to.height, to.width
    ))
}

fn fail(reason: String) -> Error {
    Error::config("image size", reason)
}

#[cfg(test)]
mod tests;

//! Objects that the robot moves, in predicted pictures.

use std::collections::BTreeMap;

use wm_dataset::FIRST_OBJECT;

/// Least way of an object's middle that counts as a motion, as a fraction of the picture's width.
const LEAST_WAY: f64 = 0.03;
/// Smaller areas have no reliable colour \[pixels\].
const LEAST_AREA: usize = 12;
/// An object is searched for as far from its true place, as a fraction of the picture's width.
const REACH: f64 = 0.06;
/// Distance of the surroundings that an object is compared with \[pixels\].
const RIM: usize = 3;
/// Least distance of the colours of an object and of its surroundings, 0 to the root of 3.
const LEAST_CONTRAST: f64 = 0.15;

type Colour = [f64; 3];

/// Counts of objects that moved since the last observed frame, and of those that the prediction has lost.
///
/// The outline of the true object is moved over the prediction, by at most 6 % of the picture's width. The object is there if
/// somewhere the mean colour inside is nearer to its true colour than half the distance of that to the surroundings' colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MovedObjects {
    /// Objects that moved, and differ in colour from what surrounds them.
    pub moved: usize,
    /// Those that are nowhere near their true place in the prediction.
    pub vanished: usize,
}

/// A true picture with its mask, and the mask of the last observed one.
pub(super) struct Truth<'a> {
    /// RGB, row by row.
    pub pixels: &'a [u8],
    pub mask: &'a [u8],
    pub observed_mask: &'a [u8],
    pub width: usize,
}

impl MovedObjects {
    /// The counts in one prediction, RGB of 0 to 1, row by row.
    pub(super) fn of(truth: &Truth<'_>, predicted: &[f32]) -> Self {
        let before = outlines(truth.observed_mask, truth.width);
        let mut counts = Self::default();
        for (object, outline) in outlines(truth.mask, truth.width) {
            let Some(before) = before.get(&object) else {
                continue;
            };
            let moved = distance(middle(before), middle(&outline));
            if moved < LEAST_WAY * truth.width as f64 || outline.len() < LEAST_AREA {
                continue;
            }
            let Some(there) = truth.shows(&outline, predicted) else {
                continue;
            };
            counts.moved += 1;
            counts.vanished += usize::from(!there);
        }
        counts
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.moved += other.moved;
        self.vanished += other.vanished;
    }
}

impl Truth<'_> {
    /// Whether `predicted` shows the object of this outline; `None` if its colour is that of its surroundings, or the picture
    /// shows no surroundings.
    fn shows(&self, outline: &[Place], predicted: &[f32]) -> Option<bool> {
        let true_at = |place: Place| {
            let [r, g, b] = pixel(self.pixels, place, self.width)?;
            Some([r, g, b].map(|value| f64::from(value) / 255.0))
        };
        let predicted_at = |place: Place| Some(pixel(predicted, place, self.width)?.map(f64::from));
        let own = mean(outline.iter().copied().filter_map(true_at))?;
        let around = mean(self.surroundings(outline).filter_map(true_at))?;
        let contrast = colour_distance(own, around);
        if contrast < LEAST_CONTRAST {
            return None;
        }
        let reach = (REACH * self.width as f64) as isize;
        let mut shifts = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
        Some(shifts.any(|(dx, dy)| {
            let shifted = outline.iter().filter_map(|place| place.shifted(dx, dy));
            mean(shifted.filter_map(predicted_at))
                .is_some_and(|colour| colour_distance(colour, own) < contrast / 2.0)
        }))
    }

    /// The background [`RIM`] pixels left and right of, above and below each pixel of an outline.
    fn surroundings<'a>(&'a self, outline: &'a [Place]) -> impl Iterator<Item = Place> + 'a {
        let rim = RIM as isize;
        let ways = [(-rim, 0), (rim, 0), (0, -rim), (0, rim)];
        outline
            .iter()
            .flat_map(move |place| ways.map(|(dx, dy)| place.shifted(dx, dy)))
            .flatten()
            .filter(|place| place.x < self.width)
            .filter(|place| self.mask.get(place.y * self.width + place.x) == Some(&0))
    }
}

/// A pixel.
#[derive(Clone, Copy)]
struct Place {
    x: usize,
    y: usize,
}

impl Place {
    fn shifted(self, dx: isize, dy: isize) -> Option<Self> {
        Some(Self {
            x: self.x.checked_add_signed(dx)?,
            y: self.y.checked_add_signed(dy)?,
        })
    }
}

/// The pixels of each object.
fn outlines(mask: &[u8], width: usize) -> BTreeMap<u8, Vec<Place>> {
    let mut outlines = BTreeMap::<u8, Vec<Place>>::new();
    for (y, row) in mask.chunks(width.max(1)).enumerate() {
        for (x, object) in row.iter().enumerate() {
            if *object >= FIRST_OBJECT {
                outlines.entry(*object).or_default().push(Place { x, y });
            }
        }
    }
    outlines
}

fn middle(outline: &[Place]) -> (f64, f64) {
    let count = outline.len().max(1) as f64;
    let sum = outline.iter().fold((0.0, 0.0), |(x, y), place| {
        (x + place.x as f64, y + place.y as f64)
    });
    (sum.0 / count, sum.1 / count)
}

fn distance((x, y): (f64, f64), (u, v): (f64, f64)) -> f64 {
    (x - u).hypot(y - v)
}

fn pixel<T: Copy>(values: &[T], place: Place, width: usize) -> Option<[T; 3]> {
    if place.x >= width {
        return None;
    }
    let first = 3 * (place.y * width + place.x);
    values.get(first..first + 3)?.try_into().ok()
}

fn mean(colours: impl Iterator<Item = Colour>) -> Option<Colour> {
    let (mut sum, mut count) = ([0.0; 3], 0_usize);
    for colour in colours {
        for (sum, value) in sum.iter_mut().zip(colour) {
            *sum += value;
        }
        count += 1;
    }
    (count > 0).then(|| sum.map(|sum| sum / count as f64))
}

fn colour_distance(a: Colour, b: Colour) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 64;
    const RED: [u8; 3] = [200, 30, 30];
    const TABLE: [u8; 3] = [120, 110, 100];

    /// A square of 5 x 5 pixels at (x, 20), and its mask.
    fn picture(x: usize, colour: [u8; 3]) -> (Vec<u8>, Vec<u8>) {
        let (mut pixels, mut mask) = (Vec::new(), Vec::new());
        for row in 0..48 {
            for column in 0..WIDTH {
                let inside = (20..25).contains(&row) && (x..x + 5).contains(&column);
                pixels.extend(if inside { colour } else { TABLE });
                mask.push(if inside { FIRST_OBJECT } else { 0 });
            }
        }
        (pixels, mask)
    }

    fn counts(
        observed: usize,
        seen: (usize, [u8; 3]),
        predicted: (usize, [u8; 3]),
    ) -> (usize, usize) {
        let (pixels, mask) = picture(seen.0, seen.1);
        let (_, observed_mask) = picture(observed, RED);
        let (predicted, _) = picture(predicted.0, predicted.1);
        let predicted: Vec<f32> = predicted
            .iter()
            .map(|value| f32::from(*value) / 255.0)
            .collect();
        let truth = Truth {
            pixels: &pixels,
            mask: &mask,
            observed_mask: &observed_mask,
            width: WIDTH,
        };
        let counts = MovedObjects::of(&truth, &predicted);
        (counts.moved, counts.vanished)
    }

    #[test]
    fn object_near_its_true_place_is_there() {
        assert_eq!(counts(10, (30, RED), (30, RED)), (1, 0));
        // A picture of 64 pixels: at most 3 away.
        assert_eq!(counts(10, (30, RED), (33, RED)), (1, 0));
        assert_eq!(counts(10, (30, RED), (40, RED)), (1, 1));
    }

    #[test]
    fn object_without_its_colour_has_vanished() {
        assert_eq!(counts(10, (30, RED), (30, TABLE)), (1, 1));
        assert_eq!(counts(10, (30, RED), (30, [30, 30, 200])), (1, 1));
    }

    #[test]
    fn only_moved_and_visible_objects_count() {
        assert_eq!(counts(30, (30, RED), (30, TABLE)), (0, 0));
        assert_eq!(counts(10, (30, TABLE), (30, TABLE)), (0, 0));
    }

    #[test]
    fn objects_at_the_border_and_other_pictures_do_not_panic() {
        assert_eq!(counts(10, (0, RED), (0, RED)), (1, 0));
        assert_eq!(counts(10, (59, RED), (59, RED)), (1, 0));
        let empty = Truth {
            pixels: &[],
            mask: &[],
            observed_mask: &[],
            width: 0,
        };
        assert_eq!(MovedObjects::of(&empty, &[]), MovedObjects::default());
    }
}

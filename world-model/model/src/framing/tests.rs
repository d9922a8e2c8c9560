use proptest::prelude::*;

use super::*;
use crate::image::resize;

fn size(width: u32, height: u32) -> PictureSize {
    PictureSize { width, height }
}

fn part(x: u32, y: u32, width: u32, height: u32) -> Part {
    Part {
        x,
        y,
        width,
        height,
    }
}

/// Each pixel names its place.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([x as u8, y as u8, 200]))
}

#[test]
fn wide_and_tall_pictures_are_cut_in_the_middle() {
    for (from, to, source) in [
        (size(1280, 720), size(256, 256), part(280, 0, 720, 720)),
        (size(640, 480), size(128, 128), part(80, 0, 480, 480)),
        (size(480, 640), size(128, 128), part(0, 80, 480, 480)),
        // An odd remainder: one pixel more is cut at the right.
        (size(641, 480), size(128, 128), part(80, 0, 480, 480)),
        (size(641, 481), size(2, 1), part(0, 80, 641, 321)),
        // Sides of one pixel stay.
        (size(1, 1000), size(16, 9), part(0, 499, 1, 1)),
        (size(1000, 1), size(128, 128), part(499, 0, 1, 1)),
        // Enlarged.
        (size(3, 2), size(64, 64), part(0, 0, 2, 2)),
    ] {
        let found = Fit::Crop.placement(from, to).unwrap();
        assert_eq!(found.source, source, "{from} to {to}");
        assert_eq!(found.target, Part::whole(to), "{from} to {to}");
    }
}

#[test]
fn wide_and_tall_pictures_get_bars() {
    for (from, to, target) in [
        (size(1280, 720), size(256, 256), part(0, 56, 256, 144)),
        (size(480, 640), size(128, 128), part(16, 0, 96, 128)),
        // 85.33 rows round to 85: one bar is a row higher than the other.
        (size(3, 2), size(128, 128), part(0, 21, 128, 85)),
        (size(1000, 1), size(128, 128), part(0, 63, 128, 1)),
        (size(1, 1), size(2, 5), part(0, 1, 2, 2)),
    ] {
        let found = Fit::Pad.placement(from, to).unwrap();
        assert_eq!(found.target, target, "{from} to {to}");
        assert_eq!(found.source, Part::whole(from), "{from} to {to}");
    }
}

#[test]
fn a_cropped_picture_is_its_middle_resized() {
    let source = picture(16, 9);
    let middle = image::imageops::crop_imm(&source, 3, 0, 9, 9).to_image();
    for side in [3, 9, 20] {
        let cropped = Framing::new((side, side), Fit::Crop).apply(&source);
        assert_eq!(cropped.unwrap(), resize(&middle, (side, side)).unwrap());
    }
}

#[test]
fn a_padded_picture_is_whole_between_black_bars() {
    let source = picture(16, 9);
    let padded = Framing::new((32, 32), Fit::Pad).apply(&source).unwrap();
    let inner = image::imageops::crop_imm(&padded, 0, 7, 32, 18).to_image();
    assert_eq!(inner, resize(&source, (18, 32)).unwrap());
    let bars = padded
        .enumerate_rows()
        .filter(|(y, _)| !(7..25).contains(y));
    let mut pixels = bars.flat_map(|(_, row)| row);
    assert!(pixels.all(|(_, _, pixel)| *pixel == BARS));
}

#[test]
fn a_picture_of_the_right_size_stays_as_it_is() {
    for fit in Fit::ALL {
        let source = picture(17, 5);
        assert_eq!(Framing::new((5, 17), fit).apply(&source).unwrap(), source);
    }
}

#[test]
fn several_cameras_are_cut_one_by_one() {
    let (left, right) = (picture(16, 9), picture(16, 9));
    let mut beside = RgbImage::new(32, 9);
    paste(&mut beside, &left, (0, 0)).unwrap();
    paste(&mut beside, &right, (16, 0)).unwrap();
    let one = Framing::new((4, 4), Fit::Crop);
    let both = Framing {
        size: (4, 8),
        views: 2,
        ..one
    };
    let found = both.apply(&beside).unwrap();
    let mut expected = RgbImage::new(8, 4);
    paste(&mut expected, &one.apply(&left).unwrap(), (0, 0)).unwrap();
    paste(&mut expected, &one.apply(&right).unwrap(), (4, 0)).unwrap();
    assert_eq!(found, expected);
    let pixel = |x| both.pixel(size(32, 9), (x, 0)).unwrap();
    assert_eq!(
        [2, 3, 11, 12, 18, 19]
            .map(pixel)
            .map(|at| at.map(|(x, _)| x)),
        [None, Some(0), Some(3), None, None, Some(4)]
    );
    let error = both.apply(&picture(33, 9)).unwrap_err().to_string();
    assert!(error.contains("33x9 cannot show 2 cameras"), "{error}");
}

#[test]
fn a_view_gives_the_part_that_the_model_sees() {
    let (from, to) = (size(1280, 720), size(256, 256));
    let view = |fit: Fit| fit.placement(from, to).unwrap().view(to);
    assert_eq!(view(Fit::Stretch), [0.0, 0.0, 1280.0, 720.0]);
    assert_eq!(view(Fit::Crop), [280.0, 0.0, 720.0, 720.0]);
    assert_eq!(view(Fit::Pad), [0.0, -280.0, 1280.0, 1280.0]);
}

#[test]
fn empty_pictures_and_sizes_are_refused() {
    for fit in Fit::ALL {
        assert_eq!(fit.placement(size(0, 4), size(4, 4)), None);
        for (source, to) in [(RgbImage::new(0, 0), (4, 4)), (picture(4, 4), (4, 0))] {
            let error = Framing::new(to, fit).apply(&source).unwrap_err();
            assert!(error.to_string().contains("at least one pixel"), "{error}");
        }
    }
}

#[test]
fn joined_pictures_are_placed_one_by_one() {
    for fit in Fit::ALL {
        let framing = Framing {
            views: 2,
            ..Framing::new((32, 48), fit)
        };
        let cameras = [picture(64, 48), picture(30, 90)];
        let joined = framing.join(&cameras).unwrap();
        assert_eq!(joined.dimensions(), (48, 32));
        for (view, camera) in (0..).zip(&cameras) {
            let own = Framing::new((32, 24), fit).apply(camera).unwrap();
            let part = image::imageops::crop_imm(&joined, view * 24, 0, 24, 32);
            assert_eq!(part.to_image(), own, "{fit}");
        }
        // The encoder leaves it as it is.
        assert_eq!(framing.apply(&joined).unwrap(), joined);
    }
}

#[test]
fn wrong_number_of_joined_pictures_is_refused() {
    let framing = Framing {
        views: 3,
        ..Framing::new((32, 48), Fit::Crop)
    };
    let error = framing.join(&[picture(8, 8), picture(8, 8)]).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("2 pictures side by side: expected 3")
    );
    let uneven = Framing {
        size: (32, 50),
        ..framing
    };
    let pictures = [picture(8, 8), picture(8, 8), picture(8, 8)];
    assert!(uneven.join(&pictures).is_err());
}

#[test]
fn fits_are_read_by_their_names() {
    for fit in Fit::ALL {
        assert_eq!(fit.name().parse(), Ok(fit));
        assert_eq!(serde_json::json!(fit), serde_json::json!(fit.name()));
    }
    let error = "squeeze".parse::<Fit>().unwrap_err();
    assert!(error.contains("stretch, crop or pad"), "{error}");
}

proptest! {
    #[test]
    fn parts_lie_within_their_pictures(
        from in (1u32..5000, 1u32..5000), to in (1u32..600, 1u32..600), fit in prop::sample::select(&Fit::ALL[..])
    ) {
        let (from, to) = (size(from.0, from.1), size(to.0, to.1));
        let Placement { source, target } = fit.placement(from, to).unwrap();
        for (part, whole) in [(source, from), (target, to)] {
            prop_assert!(part.width > 0 && part.height > 0);
            prop_assert!(part.x + part.width <= whole.width && part.y + part.height <= whole.height);
        }
        let corner = (source.x + source.width - 1, source.y + source.height - 1);
        let (x, y) = Placement { source, target }.pixel(corner).unwrap();
        prop_assert!(x < to.width && y < to.height);
    }

    #[test]
    fn every_fit_is_the_same_for_a_picture_of_the_models_aspect(
        shape in (1u32..20, 1u32..20), scales in (1u32..6, 1u32..6)
    ) {
        let scaled = |scale| size(shape.0 * scale, shape.1 * scale);
        let (from, to) = (scaled(scales.0), scaled(scales.1));
        prop_assert!(from.has_aspect_of(to));
        for fit in Fit::ALL {
            prop_assert_eq!(fit.placement(from, to), Fit::Stretch.placement(from, to));
        }
    }
}

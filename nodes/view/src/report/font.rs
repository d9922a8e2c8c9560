//! Text in a picture, in an 8x8 bitmap font.

use font8x8::{BASIC_FONTS, UnicodeFonts as _};
use image::{Rgb, RgbImage};

/// Width and height of a character \[px\].
pub(super) const CHARACTER: u32 = 8;

/// Writes `text` with its upper left corner at (x, y), clipped to the picture.
pub(super) fn write(picture: &mut RgbImage, text: &str, x: u32, y: u32, colour: Rgb<u8>) {
    let mut left = x;
    for character in text.chars() {
        // characters that the font lacks are blank
        let rows = BASIC_FONTS.get(character).unwrap_or_default();
        for (row, bits) in (0..).zip(rows) {
            for column in (0..CHARACTER).filter(|column| bits >> column & 1 == 1) {
                if let Some(pixel) = picture.get_pixel_mut_checked(left + column, y + row) {
                    *pixel = colour;
                }
            }
        }
        left += CHARACTER;
    }
}

/// The width of `text` \[px\].
pub(super) fn width(text: &str) -> u32 {
    // labels are a few words
    text.chars().count() as u32 * CHARACTER
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_drawn_and_clipped_at_the_edge() {
        let mut picture = RgbImage::new(20, 8);
        write(&mut picture, "kk=", 0, 0, Rgb([255; 3]));
        let ink =
            |from, to| (from..to).any(|x| (0..8).any(|y| picture.get_pixel(x, y).0 == [255; 3]));
        assert!(ink(0, 8) && ink(8, 16) && ink(16, 20));
        assert_eq!(width("kk="), 24);
    }
}

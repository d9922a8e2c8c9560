#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use proptest::prelude::*;

use super::*;

/// A 2x2 image of 3 pixels' step: rows padded by bytes that must not be read.
fn padded(encoding: &str, pixels: [&[u8]; 4]) -> Image {
    let bytes = pixels[0].len();
    let mut data = Vec::new();
    for row in pixels.chunks(2) {
        data.extend(row.concat());
        data.extend(vec![99; bytes]);
    }
    Image {
        header: Header::default(),
        height: 2,
        width: 2,
        encoding: encoding.into(),
        is_bigendian: 0,
        step: (bytes * 3) as u32,
        data,
    }
}

#[test]
fn every_encoding_comes_out_as_rgb_whatever_the_step() {
    let expected = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
    let rgb = padded("rgb8", [&[1, 2, 3], &[4, 5, 6], &[7, 8, 9], &[10, 11, 12]]);
    let bgr = padded("bgr8", [&[3, 2, 1], &[6, 5, 4], &[9, 8, 7], &[12, 11, 10]]);
    let rgba = padded(
        "rgba8",
        [
            &[1, 2, 3, 0],
            &[4, 5, 6, 0],
            &[7, 8, 9, 0],
            &[10, 11, 12, 0],
        ],
    );
    let bgra = padded(
        "bgra8",
        [
            &[3, 2, 1, 0],
            &[6, 5, 4, 0],
            &[9, 8, 7, 0],
            &[12, 11, 10, 0],
        ],
    );
    for image in [rgb, bgr, rgba, bgra] {
        assert_eq!(
            decode_image(&image).unwrap().as_raw(),
            &expected,
            "{}",
            image.encoding
        );
    }
    let grey = [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4];
    let mono = padded("mono8", [&[1], &[2], &[3], &[4]]);
    assert_eq!(decode_image(&mono).unwrap().as_raw(), &grey);
    let little = padded("mono16", [&[0, 1], &[0, 2], &[0, 3], &[0, 4]]);
    assert_eq!(decode_image(&little).unwrap().as_raw(), &grey);
    let big = Image {
        is_bigendian: 1,
        ..padded("mono16", [&[1, 0], &[2, 0], &[3, 0], &[4, 0]])
    };
    assert_eq!(decode_image(&big).unwrap().as_raw(), &grey);
}

#[test]
fn each_error_names_what_is_wrong() {
    let good = padded("rgb8", [&[1, 2, 3], &[4, 5, 6], &[7, 8, 9], &[10, 11, 12]]);
    let message = |image: Image| decode_image(&image).unwrap_err().to_string();
    assert!(
        message(Image {
            encoding: "bayer_rggb8".into(),
            ..good.clone()
        })
        .contains("\"bayer_rggb8\"")
    );
    assert!(
        message(Image {
            step: 5,
            ..good.clone()
        })
        .contains("step is 5 bytes")
    );
    assert!(
        message(Image {
            width: 0,
            ..good.clone()
        })
        .contains("0x2")
    );
    assert!(
        message(Image {
            height: 1 << 30,
            ..good.clone()
        })
        .contains("2x1073741824")
    );
    let short = Image {
        data: good.data[..17].to_vec(),
        ..good
    };
    assert!(message(short).contains("17 bytes; step 9 x height 2 need 18"));

    let compressed = |format: &str, data: &[u8]| {
        let image = CompressedImage {
            header: Header::default(),
            format: format.into(),
            data: data.to_vec(),
        };
        decode_compressed(&image).unwrap_err().to_string()
    };
    assert!(compressed("webp", &[]).contains("\"webp\""));
    assert!(compressed("jpeg", &[0xff, 0xd8, 0xff]).contains("(jpeg)"));
    assert!(compressed("rgb8; png compressed", b"not a png").contains("(png)"));
}

#[test]
fn a_png_that_claims_more_than_the_bound_is_refused_before_it_is_allocated() {
    // Signature and a header chunk of 60000x60000 pixels, its checksum right, so that only the size is wrong.
    let mut data = vec![0x89, b'P', b'N', b'G', 13, 10, 26, 10, 0, 0, 0, 13];
    let mut chunk = b"IHDR".to_vec();
    chunk.extend(60_000_u32.to_be_bytes());
    chunk.extend(60_000_u32.to_be_bytes());
    chunk.extend([8, 2, 0, 0, 0]);
    let checksum = chunk.iter().fold(!0_u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg())
        })
    });
    data.extend(chunk);
    data.extend((!checksum).to_be_bytes());
    data.extend([0, 0, 0, 0, b'I', b'D', b'A', b'T', 0x35, 0xaf, 0x06, 0x1e]);
    let image = CompressedImage {
        header: Header::default(),
        format: "png".into(),
        data,
    };
    let error = decode_compressed(&image).unwrap_err();
    assert!(
        matches!(
            &error,
            ImageError::Codec {
                source: image::ImageError::Limits(_),
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn jpeg_and_png_round_trip() {
    let rgb = RgbImage::from_fn(32, 16, |x, y| image::Rgb([x as u8 * 4, y as u8 * 8, 60]));
    let jpeg = encode_jpeg(&rgb, Header::default(), 95).unwrap();
    let back = decode_compressed(&jpeg).unwrap();
    let worst = back
        .as_raw()
        .iter()
        .zip(rgb.as_raw())
        .map(|(a, b)| a.abs_diff(*b))
        .max()
        .unwrap();
    // Smooth ramps at quality 95 with subsampled colour.
    assert!(worst <= 10, "{worst}");

    let mut png = Cursor::new(Vec::new());
    rgb.write_to(&mut png, ImageFormat::Png).unwrap();
    let png = CompressedImage {
        header: Header::default(),
        format: "png".into(),
        data: png.into_inner(),
    };
    assert_eq!(decode_compressed(&png).unwrap(), rgb);
}

proptest! {
    #[test]
    fn raw_images_round_trip(width in 1_u32..9, height in 1_u32..9, seed in any::<u8>()) {
        let rgb = RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([seed.wrapping_add(x as u8), seed.wrapping_mul(y as u8), seed])
        });
        prop_assert_eq!(decode_image(&encode_image(&rgb, Header::default())).unwrap(), rgb);
    }

    /// Whatever comes, it is an image or an error.
    #[test]
    fn no_message_panics(
        width in any::<u32>(), height in any::<u32>(), step in any::<u32>(), small in any::<bool>(),
        encoding in prop::sample::select(vec!["rgb8", "mono8", "mono16", "bgra8", "x"]),
        data in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let bound = |value: u32| if small { value % 8 } else { value };
        let image = Image {
            header: Header::default(), width: bound(width), height: bound(height), step: bound(step),
            encoding: encoding.into(), is_bigendian: 0, data: data.clone(),
        };
        let _ = decode_image(&image);
        let _ = decode_compressed(&CompressedImage { header: Header::default(), format: "jpeg".into(), data });
    }
}

#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use image::{ImageBuffer, ImageFormat, Luma};
use proptest::prelude::*;

use super::*;

/// A 2x2 image with a step of 3 pixels; the padding must not be read.
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
fn every_encoding_becomes_rgb_with_any_step() {
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
    // OpenCV's types are in BGR order.
    let bgr = padded("8UC3", [&[3, 2, 1], &[6, 5, 4], &[9, 8, 7], &[12, 11, 10]]);
    assert_eq!(decode_image(&bgr).unwrap().as_raw(), &expected);
    let grey = [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4];
    for encoding in ["mono8", "8UC1"] {
        let mono = padded(encoding, [&[1], &[2], &[3], &[4]]);
        assert_eq!(decode_image(&mono).unwrap().as_raw(), &grey);
    }
}

#[test]
fn last_padding_and_step_may_be_missing() {
    let expected = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
    let padded = padded("rgb8", [&[1, 2, 3], &[4, 5, 6], &[7, 8, 9], &[10, 11, 12]]);
    let short = Image {
        data: padded.data[..15].to_vec(),
        ..padded.clone()
    };
    let longer = Image {
        data: [padded.data.as_slice(), &[7; 99]].concat(),
        ..padded.clone()
    };
    let unnamed = Image {
        step: 0,
        data: expected.to_vec(),
        ..padded
    };
    for image in [short, longer, unnamed] {
        assert_eq!(decode_image(&image).unwrap().as_raw(), &expected);
    }
}

/// RGB and BT.601 (limited range) of black, white, red and blue, computed by OpenCV's cvtColor.
const YUV: [([u8; 3], [u8; 3]); 4] = [
    ([16, 128, 128], [0, 0, 0]),
    ([235, 128, 128], [255, 255, 255]),
    ([82, 90, 240], [255, 1, 0]),
    ([41, 240, 110], [0, 0, 255]),
];

#[test]
fn yuv_is_converted_by_bt601() {
    for ([luma, blue, red], rgb) in YUV {
        let expected: Vec<u8> = [rgb; 8].concat();
        let image = |encoding: &str, step: u32, data: Vec<u8>| Image {
            encoding: encoding.into(),
            width: 4,
            height: 2,
            step,
            data,
            ..Image::default()
        };
        let lumas = vec![luma; 8];
        let images = [
            image("yuv422", 8, [[blue, luma, red, luma]; 4].concat()),
            image("uyvy", 8, [[blue, luma, red, luma]; 4].concat()),
            image("yuv422_yuy2", 8, [[luma, blue, luma, red]; 4].concat()),
            image("yuyv", 8, [[luma, blue, luma, red]; 4].concat()),
            image(
                "nv12",
                4,
                [lumas.clone(), [[blue, red]; 2].concat()].concat(),
            ),
            image(
                "nv21",
                4,
                [lumas.clone(), [[red, blue]; 2].concat()].concat(),
            ),
            image("nv24", 4, [lumas, [[blue, red]; 8].concat()].concat()),
        ];
        for image in images {
            let got = decode_image(&image).unwrap();
            let worst = got
                .as_raw()
                .iter()
                .zip(&expected)
                .map(|(a, b)| a.abs_diff(*b))
                .max();
            assert!(worst <= Some(1), "{}: {got:?}", image.encoding);
        }
    }
}

#[test]
fn planes_of_padded_pictures_are_found() {
    // 3 x 3 pixels in rows of 6 bytes: 3 rows of luma, 2 of pairs; no padding after the last row.
    let mut data = vec![0xab; 6 * 4 + 4];
    for row in 0..3 {
        data[row * 6..row * 6 + 3].fill(82);
    }
    for row in 3..5 {
        data[row * 6..row * 6 + 4].copy_from_slice(&[90, 240, 90, 240]);
    }
    let image = Image {
        encoding: "nv12".into(),
        width: 3,
        height: 3,
        step: 6,
        data,
        ..Image::default()
    };
    let got = decode_image(&image).unwrap();
    assert!(
        got.pixels().all(|pixel| pixel.0[0] > 253 && pixel.0[1] < 3),
        "{got:?}"
    );
    let data = image.data[..27].to_vec();
    assert!(decode_image(&Image { data, ..image }).is_err());
}

#[test]
fn each_mosaic_pattern_becomes_rgb() {
    let colour = [200, 100, 50];
    for (encoding, pattern) in [
        ("bayer_rggb8", [0, 1, 1, 2]),
        ("bayer_bggr8", [2, 1, 1, 0]),
        ("bayer_gbrg8", [1, 2, 0, 1]),
        ("bayer_grbg8", [1, 0, 2, 1]),
    ] {
        for (width, height) in [(2_u32, 2_u32), (7, 5), (8, 4)] {
            let pixel = |x: u32, y: u32| colour[pattern[(y % 2 * 2 + x % 2) as usize]];
            let rows = (0..height).flat_map(|y| (0..width).map(move |x| pixel(x, y)));
            let image = Image {
                encoding: encoding.into(),
                width,
                height,
                step: width,
                data: rows.collect(),
                ..Image::default()
            };
            let got = decode_image(&image).unwrap();
            assert!(
                got.pixels().all(|pixel| pixel.0 == colour),
                "{encoding} {width}x{height}"
            );
        }
    }
}

#[test]
fn mosaic_is_interpolated_linearly() {
    // Inside, the interpolation of a ramp is the ramp itself.
    let ramp = |x: u32, y: u32| (10 * x + 20 * y) as u8;
    let image = Image {
        encoding: "bayer_grbg8".into(),
        width: 6,
        height: 6,
        step: 6,
        data: (0..36).map(|at| ramp(at % 6, at / 6)).collect(),
        ..Image::default()
    };
    let got = decode_image(&image).unwrap();
    for (x, y, pixel) in got.enumerate_pixels() {
        if (1..5).contains(&x) && (1..5).contains(&y) {
            assert_eq!(pixel.0, [ramp(x, y); 3], "{x}, {y}");
        }
    }
}

#[test]
fn depth_is_rejected_by_name() {
    for encoding in ["16UC1", "32FC1", "mono16"] {
        let image = Image {
            encoding: encoding.into(),
            width: 2,
            height: 2,
            step: 8,
            data: vec![1; 16],
            ..Image::default()
        };
        let error = decode_image(&image).unwrap_err();
        assert!(matches!(error, ImageError::Depth(_)), "{error}");
        assert!(error.to_string().contains(encoding), "{error}");
    }
    let depth = ImageBuffer::<Luma<u16>, _>::from_pixel(4, 4, Luma([1200]));
    let mut png = Cursor::new(Vec::new());
    depth.write_to(&mut png, ImageFormat::Png).unwrap();
    let compressed = |format: &str, data: Vec<u8>| CompressedImage {
        format: format.into(),
        data,
        ..CompressedImage::default()
    };
    let png = png.into_inner();
    let with_header = [&[0; 12], png.as_slice()].concat();
    for image in [
        compressed("16UC1; png compressed", png),
        compressed("16UC1; compressedDepth png", with_header.clone()),
        // Bytes win over the format.
        compressed("jpeg", with_header),
        compressed("16UC1; compressedDepth rvl", vec![0; 40]),
    ] {
        for error in [
            decode_compressed(&image).unwrap_err(),
            check_compressed(&image).unwrap_err(),
        ] {
            assert!(
                matches!(error, ImageError::Depth(_)),
                "{}: {error}",
                image.format
            );
        }
    }
}

#[test]
fn bytes_decide_the_codec() {
    let rgb = RgbImage::from_pixel(16, 16, image::Rgb([200, 20, 20]));
    let jpeg = encode_jpeg(&rgb, Header::default(), 95).unwrap().data;
    let mut png = Cursor::new(Vec::new());
    rgb.write_to(&mut png, ImageFormat::Png).unwrap();
    let png = png.into_inner();
    for format in [
        "",
        "rgb8",
        "bgr8",
        "jpeg",
        "png",
        "mjpeg",
        "rgb8; png compressed",
        "webp",
    ] {
        for (data, expected) in [(&jpeg, Format::Jpeg), (&png, Format::Png)] {
            let image = CompressedImage {
                format: format.into(),
                data: data.clone(),
                ..CompressedImage::default()
            };
            assert_eq!(
                check_compressed(&image).unwrap(),
                (expected, (16, 16)),
                "{format}"
            );
            let red = decode_compressed(&image).unwrap().get_pixel(8, 8).0;
            assert!(red[0] > 190 && red[1] < 30, "{format}: {red:?}");
        }
    }
    for (data, name) in [
        (&b"RIFF\x10\0\0\0WEBPVP8 "[..], "WebP"),
        (b"\0\0\0\x01\x67", "h264"),
        (b"\x28\xb5\x2f\xfd\0", "zstd"),
        (b"", "empty"),
        (b"hello, world", "unknown"),
    ] {
        let image = CompressedImage {
            format: "jpeg".into(),
            data: data.to_vec(),
            ..CompressedImage::default()
        };
        let error = decode_compressed(&image).unwrap_err().to_string();
        assert!(
            error.contains(name) && error.contains("\"jpeg\""),
            "{error}"
        );
    }
}

#[test]
fn incomplete_png_is_rejected() {
    let rgb = RgbImage::from_fn(40, 30, |x, y| image::Rgb([(x * y) as u8, x as u8, y as u8]));
    let mut png = Cursor::new(Vec::new());
    rgb.write_to(&mut png, ImageFormat::Png).unwrap();
    let png = png.into_inner();
    // The end marker: 12 bytes without pixels.
    for length in 0..png.len() - 12 {
        let image = CompressedImage {
            data: png[..length].to_vec(),
            ..CompressedImage::default()
        };
        assert!(
            decode_compressed(&image).is_err(),
            "{length} of {} bytes",
            png.len()
        );
    }
    for missing in 8..png.len() - 16 {
        let data = [&png[..missing], &png[missing + 3..]].concat();
        let image = CompressedImage {
            data,
            ..CompressedImage::default()
        };
        assert!(decode_compressed(&image).is_err(), "without byte {missing}");
    }
}

#[test]
fn each_error_names_the_fault() {
    let good = padded("rgb8", [&[1, 2, 3], &[4, 5, 6], &[7, 8, 9], &[10, 11, 12]]);
    let message = |image: Image| decode_image(&image).unwrap_err().to_string();
    assert!(
        message(Image {
            encoding: "bayer_rggb16".into(),
            ..good.clone()
        })
        .contains("\"bayer_rggb16\"")
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
        data: good.data[..14].to_vec(),
        ..good
    };
    assert!(message(short).contains("14 bytes; step 9 x height 2 need 15"));

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
    assert!(compressed("", b"\x89PNG\r\n\x1a\nnot a png").contains("(png)"));
}

#[test]
fn too_large_png_is_rejected_before_allocation() {
    // Signature and a header chunk of 60000x60000 pixels with a correct checksum.
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

    /// Any message gives an image or an error.
    #[test]
    fn decoder_survives_arbitrary_messages(
        width in any::<u32>(), height in any::<u32>(), step in any::<u32>(), small in any::<bool>(),
        encoding in prop::sample::select(vec!["rgb8", "mono8", "mono16", "bgra8", "yuyv", "nv12", "nv21", "nv24", "bayer_rggb8", "x"]),
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

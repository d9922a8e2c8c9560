//! Arrays of an `.npz`: numbers, booleans and texts.

use std::{
    fmt,
    fs::File,
    io::{BufReader, Read as _},
    path::Path,
};

use npyz::{DType, Endianness, NpyFile, NpyHeader, Order, TypeChar};
use zip::ZipArchive;

/// Limit of an array \[bytes\]; those of episodes are far smaller.
const MAX_BYTES: u64 = 64 << 20;

pub(super) struct Arrays {
    archive: ZipArchive<BufReader<File>>,
}

/// An array of numbers, row-major.
pub(super) struct Numbers {
    pub shape: Vec<u64>,
    pub values: Vec<f32>,
}

#[derive(Debug, PartialEq)]
pub(super) enum Label {
    Number(f64),
    Text(String),
    /// A pickled Python object, which is not read.
    Pickled,
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => number.fmt(f),
            Self::Text(text) => write!(f, "{text:?}"),
            Self::Pickled => write!(f, "a pickled object"),
        }
    }
}

impl Arrays {
    pub fn open(file: &Path) -> Result<Self, String> {
        let stream = File::open(file).map_err(|error| error.to_string())?;
        let archive = ZipArchive::new(BufReader::new(stream));
        Ok(Self {
            archive: archive.map_err(|error| format!("not an npz: {error}"))?,
        })
    }

    pub fn has(&self, name: &str) -> bool {
        self.archive.index_for_name(&member(name)).is_some()
    }

    fn bytes(&mut self, name: &str) -> Result<Vec<u8>, String> {
        let name = member(name);
        let mut bytes = Vec::new();
        self.archive
            .by_name(&name)
            .map_err(|error| error.to_string())?
            .take(MAX_BYTES + 1)
            .read_to_end(&mut bytes)
            .map_err(|error| format!("{name}: {error}"))?;
        if bytes.len() as u64 > MAX_BYTES {
            return Err(format!("{name} has more than {MAX_BYTES} bytes"));
        }
        Ok(bytes)
    }

    /// Reads an array of float32 or float64.
    pub fn numbers(&mut self, name: &str) -> Result<Numbers, String> {
        let bytes = self.bytes(name)?;
        let name = member(name);
        let wrong = |error: std::io::Error| format!("{name}: {error}");
        let array = NpyFile::new(&bytes[..]).map_err(wrong)?;
        if array.order() != Order::C {
            return Err(format!(
                "expected {name} in row-major (C) order, got Fortran order"
            ));
        }
        let shape = array.shape().to_vec();
        let claimed = shape.iter().try_fold(1u64, |a, b| a.checked_mul(*b));
        // Each value has at least a byte.
        if claimed.is_none_or(|claimed| claimed > bytes.len() as u64) {
            return Err(format!(
                "{name} claims a shape of {shape:?} but has {} bytes",
                bytes.len()
            ));
        }
        let values = match scalar_type(&array.dtype()) {
            Some((TypeChar::Float, 8, _)) => {
                let values = array.into_vec::<f64>().map_err(wrong)?;
                // Messages have single precision.
                values.into_iter().map(|value| value as f32).collect()
            }
            _ => array.into_vec::<f32>().map_err(wrong)?,
        };
        Ok(Numbers { shape, values })
    }

    /// The names of the arrays.
    pub fn names(&self) -> Vec<String> {
        let names = self.archive.file_names().filter_map(Result::ok);
        names
            .map(|name| name.strip_suffix(".npy").unwrap_or(&name).to_owned())
            .collect()
    }

    /// Reads a label: the last element of an array, which has one element, or one per step.
    pub fn label(&mut self, name: &str) -> Result<Label, String> {
        let bytes = self.bytes(name)?;
        let name = member(name);
        let mut rest = &bytes[..];
        let header =
            NpyHeader::from_reader(&mut rest).map_err(|error| format!("{name}: {error}"))?;
        let unknown = || {
            format!(
                "{name}: expected a number or a text, got {}",
                header.dtype().descr()
            )
        };
        let (kind, size, endianness) = scalar_type(&header.dtype()).ok_or_else(unknown)?;
        let count = header
            .shape()
            .iter()
            .try_fold(1u64, |a, b| a.checked_mul(*b));
        let last = count.and_then(|count| usize::try_from(count).ok()?.checked_sub(1));
        let last = last.ok_or_else(|| format!("{name}: expected an element, got none"))?;
        let is_big = endianness == Endianness::Big;
        let element = |size: usize| {
            let start = last.checked_mul(size);
            let element = start.and_then(|start| rest.get(start..start.checked_add(size)?));
            element.ok_or_else(|| format!("{name}: it is cut short"))
        };
        let size = usize::try_from(size).ok();
        match (kind, size) {
            (TypeChar::Object, _) => Ok(Label::Pickled),
            (TypeChar::UnicodeStr, Some(letters)) => {
                let mut text = String::new();
                for unit in element(letters.checked_mul(4).ok_or_else(unknown)?)?
                    .as_chunks::<4>()
                    .0
                {
                    let code = match is_big {
                        true => u32::from_be_bytes(*unit),
                        false => u32::from_le_bytes(*unit),
                    };
                    text.push(
                        char::from_u32(code)
                            .ok_or_else(|| format!("{name}: {code:#x} is no character"))?,
                    );
                }
                Ok(Label::Text(text.trim_end_matches('\0').to_owned()))
            }
            (TypeChar::ByteStr, Some(size)) => {
                let text = element(size)?.to_vec();
                let text = String::from_utf8(text).map_err(|error| format!("{name}: {error}"))?;
                Ok(Label::Text(text.trim_end_matches('\0').to_owned()))
            }
            (TypeChar::Float, Some(size @ (4 | 8))) => {
                let mut bits = element(size)?.to_vec();
                if is_big {
                    bits.reverse();
                }
                let number = match (
                    <[u8; 4]>::try_from(&bits[..]),
                    <[u8; 8]>::try_from(&bits[..]),
                ) {
                    (Ok(bits), _) => f64::from(f32::from_le_bytes(bits)),
                    (_, Ok(bits)) => f64::from_le_bytes(bits),
                    _ => return Err(unknown()),
                };
                Ok(Label::Number(number))
            }
            (TypeChar::Bool | TypeChar::Int | TypeChar::Uint, Some(size @ 1..=8)) => {
                let mut bits = element(size)?.to_vec();
                if is_big {
                    bits.reverse();
                }
                // The sign does not matter: labels are 0, nonzero or rejected.
                let whole = bits
                    .iter()
                    .rev()
                    .fold(0u64, |value, byte| value << 8 | u64::from(*byte));
                Ok(Label::Number(whole as f64))
            }
            _ => Err(unknown()),
        }
    }
}

fn member(name: &str) -> String {
    format!("{name}.npy")
}

/// Kind, size and byte order of the elements; `None` for records.
fn scalar_type(dtype: &DType) -> Option<(TypeChar, u64, Endianness)> {
    match dtype {
        DType::Plain(plain) => Some((plain.type_char(), plain.size_field(), plain.endianness())),
        _ => None,
    }
}

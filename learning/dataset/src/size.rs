use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// Largest side of a prepared picture.
const MOST: usize = 4096;

/// Height and width of a picture in pixels, written `128x128`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Size {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl Default for Size {
    fn default() -> Self {
        Self {
            height: 128,
            width: 128,
        }
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.height, self.width)
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| {
            let side = text.parse::<usize>().ok();
            side.filter(|side| (1..=MOST).contains(side))
        };
        let sides = text
            .split_once('x')
            .and_then(|(height, width)| side(height).zip(side(width)));
        match sides {
            Some((height, width)) => Ok(Self { height, width }),
            None => Err(format!(
                "expected HEIGHTxWIDTH, each 1 to {MOST}, such as 128x128; got {text:?}"
            )),
        }
    }
}

impl From<Size> for String {
    fn from(size: Size) -> Self {
        size.to_string()
    }
}

impl TryFrom<String> for Size {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

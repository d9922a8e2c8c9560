/// The type of a number in CDR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    Bool,
    Byte,
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

impl Scalar {
    /// Size and alignment \[byte\].
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Byte => 1,
            Self::Signed(size) | Self::Unsigned(size) | Self::Float(size) => size,
        }
    }

    /// Whether `wider` has each of its values.
    pub fn fits(self, wider: Self) -> bool {
        match (self, wider) {
            (Self::Signed(from), Self::Signed(to))
            | (Self::Unsigned(from), Self::Unsigned(to))
            | (Self::Float(from), Self::Float(to)) => from <= to,
            (Self::Unsigned(from), Self::Signed(to)) => from < to,
            // 24 and 53 bits of mantissa.
            (Self::Unsigned(from) | Self::Signed(from), Self::Float(to)) => from < to,
            (Self::Byte, Self::Unsigned(1)) | (Self::Unsigned(1), Self::Byte) => true,
            (from, to) => from == to,
        }
    }
}

/// A number of the input.
#[derive(Clone, Copy, Debug)]
pub(super) enum Number {
    Signed(i64),
    Unsigned(u64),
    Float(f64),
}

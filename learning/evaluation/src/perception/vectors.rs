use anyhow::{Context as _, Result, ensure};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::{Deserialize, Serialize};

/// Vectors of one length; in records, base64 of little-endian f32.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "EncodedVectors", into = "EncodedVectors")]
pub struct Vectors {
    length: usize,
    values: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
struct EncodedVectors {
    length: usize,
    base64: String,
}

impl Vectors {
    /// From rows.
    ///
    /// # Errors
    /// If empty, or lengths differ.
    pub fn of(vectors: &[Vec<f32>]) -> Result<Self> {
        let length = vectors.first().context("no vector")?.len();
        ensure!(
            length > 0 && vectors.iter().all(|vector| vector.len() == length),
            "vectors of different lengths, or of none"
        );
        let values = vectors.concat();
        Ok(Self { length, values })
    }

    /// Length of each.
    #[must_use]
    pub fn length(&self) -> usize {
        self.length
    }

    /// The vectors.
    pub fn iter(&self) -> impl Iterator<Item = &[f32]> {
        self.values.chunks_exact(self.length)
    }
}

impl From<Vectors> for EncodedVectors {
    fn from(vectors: Vectors) -> Self {
        let bytes: Vec<u8> = vectors
            .values
            .into_iter()
            .flat_map(f32::to_le_bytes)
            .collect();
        Self {
            length: vectors.length,
            base64: STANDARD.encode(bytes),
        }
    }
}

impl TryFrom<EncodedVectors> for Vectors {
    type Error = String;

    fn try_from(written: EncodedVectors) -> Result<Self, String> {
        let bytes = STANDARD
            .decode(written.base64)
            .map_err(|error| error.to_string())?;
        let (values, rest) = bytes.as_chunks::<4>();
        let values: Vec<f32> = values.iter().copied().map(f32::from_le_bytes).collect();
        let length = written.length;
        let fits = rest.is_empty() && length > 0 && values.len().is_multiple_of(length);
        if !fits || !values.iter().all(|value| value.is_finite()) {
            let bytes = bytes.len();
            return Err(format!(
                "{bytes} bytes are not vectors of {length} finite numbers"
            ));
        }
        Ok(Self { length, values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_round_trip_bit_for_bit() {
        let rows = [
            vec![0.1, -3.0e-30, f32::MAX],
            vec![-0.0, 1.0 / 3.0, f32::MIN_POSITIVE],
        ];
        let vectors = Vectors::of(&rows).unwrap();
        let text = serde_json::to_string(&vectors).unwrap();
        let back: Vectors = serde_json::from_str(&text).unwrap();
        assert_eq!(back, vectors);
        assert_eq!(
            (back.length(), back.iter().collect::<Vec<_>>()),
            (3, vec![&*rows[0], &rows[1]])
        );
        // 1.0 and 2.0, as numpy.frombuffer(base64.b64decode(...), "<f4") reads them.
        let text = serde_json::to_string(&Vectors::of(&[vec![1.0, 2.0]]).unwrap()).unwrap();
        assert_eq!(text, r#"{"length":2,"base64":"AACAPwAAAEA="}"#);
    }

    #[test]
    fn invalid_vectors_are_rejected() {
        assert!(Vectors::of(&[]).is_err());
        assert!(Vectors::of(&[vec![1.0], vec![1.0, 2.0]]).is_err());
        assert!(Vectors::of(&[vec![]]).is_err());
        for (length, base64) in [
            (3, "AACAPwAAAEA="),
            (0, "AACAPwAAAEA="),
            (1, "AACA"),
            (1, "AADAfw=="),
            (1, "?"),
        ] {
            let text = format!(r#"{{"length":{length},"base64":"{base64}"}}"#);
            assert!(serde_json::from_str::<Vectors>(&text).is_err(), "{text}");
        }
    }
}

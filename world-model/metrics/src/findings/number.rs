//! Numbers as text: exact for programs, three digits for people.

/// The shortest text with the exact value; zero has no sign.
pub(crate) fn exact(value: f64) -> String {
    serde_json::Number::from_f64(value + 0.0).map_or_else(String::new, |number| number.to_string())
}

/// Precision of numbers shown together: three significant digits, more for narrower intervals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Digits {
    /// Number of decimals.
    Decimals(usize),
    /// Each number as 1.23×10⁻⁴.
    Scientific,
}

impl Digits {
    /// Precision for values and their intervals.
    pub(crate) fn of(
        values: impl IntoIterator<Item = f64>,
        intervals: impl IntoIterator<Item = (f64, f64)>,
    ) -> Self {
        let (mut least, mut most, mut whole) = (f64::INFINITY, 0.0_f64, true);
        for value in values {
            let size = value.abs();
            if size > 0.0 {
                least = least.min(size);
            }
            most = most.max(size);
            whole &= value.fract() == 0.0;
        }
        let largest = most;
        let mut width = f64::INFINITY;
        for (low, high) in intervals {
            most = most.max(low.abs()).max(high.abs());
            whole &= low.fract() == 0.0 && high.fract() == 0.0;
            if high > low {
                width = width.min(high - low);
            }
        }
        if most >= 1e7 || (most > 0.0 && most < 1e-3) {
            return Self::Scientific;
        }
        if whole {
            return Self::Decimals(0);
        }
        let size = |value: f64| value.log10().floor();
        // A small value beside large ones gets at most two more decimals.
        let apart = if least.is_finite() {
            (largest / least).log10()
        } else {
            0.0
        };
        let of_values = 2.0 - size(most) + apart.floor().clamp(0.0, 2.0);
        let of_width = if width.is_finite() {
            1.0 - size(width)
        } else {
            0.0
        };
        // Between 0 and 7.
        Self::Decimals(of_values.max(of_width).clamp(0.0, 7.0) as usize)
    }

    /// A number with a true minus sign.
    pub(crate) fn show(self, value: f64) -> String {
        let text = match self {
            Self::Decimals(decimals) => format!("{value:.decimals$}"),
            Self::Scientific if value == 0.0 => "0".to_owned(),
            Self::Scientific => scientific(value),
        };
        match text.strip_prefix('-') {
            Some(rest) if rest.chars().all(|c| matches!(c, '0' | '.')) => rest.to_owned(),
            Some(rest) => format!("−{rest}"),
            None => text,
        }
    }

    /// A difference with its sign.
    pub(crate) fn signed(self, value: f64) -> String {
        let text = self.show(value);
        let zero = text.chars().all(|c| matches!(c, '0' | '.'));
        if text.starts_with('−') || zero {
            text
        } else {
            format!("+{text}")
        }
    }

    pub(crate) fn interval(self, low: f64, high: f64) -> String {
        format!("[{}, {}]", self.show(low), self.show(high))
    }
}

fn scientific(value: f64) -> String {
    let text = format!("{value:.2e}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let raised = exponent.chars().map(|digit| match digit {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '4' => '⁴',
        '5' => '⁵',
        '6' => '⁶',
        '7' => '⁷',
        '8' => '⁸',
        '9' => '⁹',
        _ => '⁰',
    });
    format!("{mantissa}×10{}", raised.collect::<String>())
}

/// A probability with two significant digits.
pub(crate) fn probability(p: f64) -> String {
    if p < 1e-4 {
        return "<0.0001".to_owned();
    }
    // p is at most 1 and not below 1e-4: between 1 and 5.
    let decimals = (1.0 - p.log10().floor()).clamp(1.0, 5.0) as usize;
    format!("{p:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn show(value: f64) -> String {
        Digits::of([value], []).show(value)
    }

    #[test]
    fn numbers_have_three_digits() {
        assert_eq!(show(0.344_44), "0.344");
        assert_eq!(show(0.084_23), "0.0842");
        assert_eq!(show(25.312), "25.3");
        assert_eq!(show(1234.5), "1234");
        assert_eq!(show(-3.4), "−3.40");
        assert_eq!(show(20.0), "20");
        assert_eq!(show(0.0), "0");
        assert_eq!(show(-0.0), "0");
        assert_eq!(show(0.000_123_4), "1.23×10⁻⁴");
        assert_eq!(show(456_789_012.0), "4.57×10⁸");
    }

    #[test]
    fn narrow_interval_raises_the_precision_of_its_row() {
        let digits = Digits::of([25.312], [(25.281, 25.344)]);
        assert_eq!(digits.interval(25.281, 25.344), "[25.281, 25.344]");
        let digits = Digits::of([0.169, 0.0], [(0.113, 0.231)]);
        assert_eq!(digits.show(0.0), "0.000");
        assert_eq!(digits.signed(-0.000_1), "0.000");
        assert_eq!(digits.signed(0.1), "+0.100");
        let digits = Digits::of([1000.0, 0.001_5], []);
        assert_eq!(digits, Digits::Decimals(1));
        let digits = Digits::of([0.000_211], [(-0.023_887, 0.023_977)]);
        assert_eq!(digits.signed(0.000_211), "+0.0002");
    }

    #[test]
    fn probabilities_have_two_digits() {
        let shown = [0.5, 0.0129, 0.00015, 0.00001, 1.0].map(probability);
        assert_eq!(shown, ["0.50", "0.013", "0.00015", "<0.0001", "1.0"]);
    }

    #[test]
    fn exact_zero_has_no_sign() {
        assert_eq!((exact(-0.0), exact(0.1)), ("0.0".into(), "0.1".into()));
        assert_eq!(exact(1e300).parse(), Ok(1e300));
    }
}

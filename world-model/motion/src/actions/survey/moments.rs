//! Running sums of two quantities.

/// Running sums for the correlation of two quantities.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    pub count: f64,
    x: f64,
    y: f64,
    xx: f64,
    yy: f64,
    xy: f64,
}

impl Moments {
    pub fn add(&mut self, x: f64, y: f64) {
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.yy += y * y;
        self.xy += x * y;
    }

    /// `count` squared times the covariance.
    fn covariance(&self) -> f64 {
        self.count * self.xy - self.x * self.y
    }

    /// `count` squared times the variances of both.
    fn variances(&self) -> (f64, f64) {
        let variance = |sum: f64, squares: f64| self.count * squares - sum * sum;
        (variance(self.x, self.xx), variance(self.y, self.yy))
    }

    /// Pearson's r; 0 without variance.
    pub fn correlation(&self) -> f64 {
        let (x, y) = self.variances();
        if x * y > 1e-12 {
            self.covariance() / (x * y).sqrt()
        } else {
            0.0
        }
    }

    /// Slope of the line that predicts y from x; 0 without variance.
    pub fn slope(&self) -> f64 {
        let (x, _) = self.variances();
        if x > 0.0 { self.covariance() / x } else { 0.0 }
    }

    /// Root mean square of x - y relative to the deviation of y; infinite without variance.
    pub fn distance(&self) -> f64 {
        let (_, y) = self.variances();
        let squares = self.count * (self.xx - 2.0 * self.xy + self.yy);
        if y > 0.0 {
            (squares.max(0.0) / y).sqrt()
        } else {
            f64::INFINITY
        }
    }
}

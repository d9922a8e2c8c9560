use wm_bag::BagReader;

/// Spans of a bag's log times, while its messages are read in order.
pub(super) struct Spans<'a> {
    reader: &'a BagReader,
    /// Number of started spans.
    begun: usize,
    /// Messages recorded at times that the clock passed twice.
    pub doubled: u64,
}

impl<'a> Spans<'a> {
    pub fn of(reader: &'a BagReader) -> Self {
        let (begun, doubled) = (0, 0);
        Self {
            reader,
            begun,
            doubled,
        }
    }

    /// Whether a message of this log time starts a span other than the first.
    pub fn begins(&mut self, log_time_ns: u64) -> bool {
        let spans = self.reader.unbroken_ns();
        let begun = spans.partition_point(|(start_ns, _)| *start_ns <= log_time_ns);
        let before = std::mem::replace(&mut self.begun, begun);
        before > 0 && begun > before
    }

    /// Whether the clock passed this time twice; counts it.
    pub fn doubles(&mut self, log_time_ns: u64) -> bool {
        let is_doubled = self.reader.is_doubled(log_time_ns);
        self.doubled += u64::from(is_doubled);
        is_doubled
    }
}

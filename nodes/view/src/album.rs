//! The pictures of the last minute, and the newest of each kind.

use crate::picture::{Label, Picture, Source};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

/// How long pictures are kept \[ns\].
pub const SPAN_NS: i64 = 60_000_000_000;

/// Pictures of one kind: of a source, and of predictions of a step k.
pub type Kind = (Source, u8);

/// Pictures by when they came, bounded by age and bytes.
#[derive(Debug)]
pub struct Album {
    /// With the time of arrival \[ns\].
    kept: VecDeque<(i64, Arc<Picture>)>,
    bytes: usize,
    limit: usize,
    /// With the number of the arrival, by which a client knows what it has.
    newest: BTreeMap<Kind, (u64, Arc<Picture>)>,
    arrivals: u64,
}

impl Album {
    /// One of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self {
            kept: VecDeque::new(),
            bytes: 0,
            limit,
            newest: BTreeMap::new(),
            arrivals: 0,
        }
    }

    /// Takes a picture that came at `now_ns`; the oldest make room.
    pub fn add(&mut self, picture: Arc<Picture>, now_ns: i64) {
        self.arrivals += 1;
        let kind = (picture.label.source, picture.label.step);
        self.newest
            .insert(kind, (self.arrivals, Arc::clone(&picture)));
        self.bytes += picture.len();
        self.kept.push_back((now_ns, picture));
        // A clock that jumps back leaves pictures of the future, which age like others from then on.
        let is_old = |then_ns: i64| now_ns.saturating_sub(then_ns) > SPAN_NS;
        while let Some((then_ns, _)) = self.kept.front()
            && (self.bytes > self.limit || is_old(*then_ns))
            && let Some((_, oldest)) = self.kept.pop_front()
        {
            self.bytes -= oldest.len();
        }
    }

    /// The picture of this label, if it is still here.
    pub fn find(&self, label: &Label) -> Option<&Arc<Picture>> {
        let is_it = |picture: &&Arc<Picture>| picture.label == *label;
        let mut pictures = self.kept.iter().rev().map(|(_, picture)| picture);
        // A goal is set once and holds: its picture may be older than those that are kept.
        let newest = || self.newest.values().map(|(_, picture)| picture).find(is_it);
        pictures.find(is_it).or_else(newest)
    }

    /// Of the newest of each kind, the one that came first after those that `has` says a client has.
    pub fn next(&self, has: &BTreeMap<Kind, u64>) -> Option<(Kind, u64, &Arc<Picture>)> {
        let is_new = |(kind, (number, _)): &(&Kind, &(u64, Arc<Picture>))| {
            has.get(kind).is_none_or(|had| had < number)
        };
        let new = self.newest.iter().filter(is_new);
        let (kind, (number, picture)) = new.min_by_key(|(_, (number, _))| *number)?;
        Some((*kind, *number, picture))
    }

    /// Bytes that are kept.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// From the oldest picture to the newest \[ns\].
    pub fn span_ns(&self) -> i64 {
        match (self.kept.front(), self.kept.back()) {
            (Some((first, _)), Some((last, _))) => last.saturating_sub(*first).max(0),
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::tests::picture;

    fn add(album: &mut Album, label: Label, now_ns: i64) {
        album.add(Arc::new(picture(label)), now_ns);
    }

    #[test]
    fn memory_is_bounded_by_bytes_and_by_age() {
        let one = picture(Label::of(Source::Camera, 0)).len();
        let mut album = Album::new(10 * one);
        for stamp in 0..100 {
            add(&mut album, Label::of(Source::Camera, stamp), stamp);
        }
        assert_eq!((album.kept.len(), album.bytes()), (10, 10 * one));
        assert!(album.find(&Label::of(Source::Camera, 89)).is_none());
        assert!(album.find(&Label::of(Source::Camera, 90)).is_some());
        add(&mut album, Label::of(Source::Camera, 100), SPAN_NS + 95);
        assert!(album.find(&Label::of(Source::Camera, 94)).is_none());
        assert!(album.find(&Label::of(Source::Camera, 95)).is_some());
    }

    #[test]
    fn a_goal_stays_when_its_minute_is_over() {
        let mut album = Album::new(1 << 20);
        add(&mut album, Label::of(Source::Goal, 1), 0);
        add(&mut album, Label::of(Source::Camera, 2), 2 * SPAN_NS);
        assert!(album.find(&Label::of(Source::Goal, 1)).is_some());
        assert_eq!(album.kept.len(), 1);
    }

    #[test]
    fn a_client_gets_the_newest_of_each_kind_in_the_order_of_arrival() {
        let mut album = Album::new(1 << 20);
        let predicted = |step, stamp_ns| Label {
            source: Source::Predicted,
            step,
            stamp_ns,
            observed_ns: 0,
        };
        add(&mut album, Label::of(Source::Camera, 1), 0);
        add(&mut album, predicted(2, 5), 1);
        add(&mut album, Label::of(Source::Camera, 2), 2);
        add(&mut album, predicted(1, 4), 3);
        let (mut has, mut sent) = (BTreeMap::new(), Vec::new());
        while let Some((kind, number, picture)) = album.next(&has) {
            sent.push((kind, picture.label.stamp_ns));
            has.insert(kind, number);
        }
        let expected = [
            ((Source::Predicted, 2), 5),
            ((Source::Camera, 0), 2),
            ((Source::Predicted, 1), 4),
        ];
        assert_eq!(sent, expected);
    }
}

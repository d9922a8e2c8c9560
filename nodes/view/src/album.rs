//! The pictures of the last minute, and the newest of each kind.

use crate::picture::{Label, Picture, Source};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

/// How long pictures are kept \[ns\].
pub(crate) const SPAN_NS: i64 = 60_000_000_000;

/// The source of a picture, and the step k of a predicted one.
pub(crate) type Kind = (Source, u8);

/// Pictures by arrival, bounded by age and bytes.
#[derive(Debug)]
pub(crate) struct Album {
    /// With the time of arrival \[ns\].
    kept: VecDeque<(i64, Arc<Picture>)>,
    bytes: usize,
    limit: usize,
    /// With the number of the arrival, by which clients track what they have.
    newest: BTreeMap<Kind, (u64, Arc<Picture>)>,
    arrivals: u64,
}

impl Album {
    /// Keeps at most `limit` bytes.
    pub(crate) fn new(limit: usize) -> Self {
        Self {
            kept: VecDeque::new(),
            bytes: 0,
            limit,
            newest: BTreeMap::new(),
            arrivals: 0,
        }
    }

    /// Adds a picture that arrived at `now_ns`, and drops the oldest.
    pub(crate) fn add(&mut self, picture: Arc<Picture>, now_ns: i64) {
        self.arrivals += 1;
        let kind = (picture.label.source, picture.label.step);
        self.newest
            .insert(kind, (self.arrivals, Arc::clone(&picture)));
        self.bytes += picture.len();
        self.kept.push_back((now_ns, picture));
        // after the clock jumps back, pictures of the future age like others from then on
        let is_old = |then_ns: i64| now_ns.saturating_sub(then_ns) > SPAN_NS;
        while let Some((then_ns, _)) = self.kept.front()
            && (self.bytes > self.limit || is_old(*then_ns))
            && let Some((_, oldest)) = self.kept.pop_front()
        {
            self.bytes -= oldest.len();
        }
    }

    /// The picture of this label, if kept.
    pub(crate) fn find(&self, label: &Label) -> Option<&Arc<Picture>> {
        let is_it = |picture: &&Arc<Picture>| picture.label == *label;
        let mut pictures = self.kept.iter().rev().map(|(_, picture)| picture);
        // a goal stays valid: its picture may be older than the kept ones
        let newest = || self.newest.values().map(|(_, picture)| picture).find(is_it);
        pictures.find(is_it).or_else(newest)
    }

    /// The newest pictures that a client lacks: returns the one that arrived first. `has`: the client's newest number
    /// of each kind.
    pub(crate) fn next(&self, has: &BTreeMap<Kind, u64>) -> Option<(Kind, u64, &Arc<Picture>)> {
        let is_new = |(kind, (number, _)): &(&Kind, &(u64, Arc<Picture>))| {
            has.get(kind).is_none_or(|had| had < number)
        };
        let new = self.newest.iter().filter(is_new);
        let (kind, (number, picture)) = new.min_by_key(|(_, (number, _))| *number)?;
        Some((*kind, *number, picture))
    }

    pub(crate) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Time between the oldest and the newest picture \[ns\].
    pub(crate) fn span_ns(&self) -> i64 {
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
    fn goal_outlives_its_minute() {
        let mut album = Album::new(1 << 20);
        add(&mut album, Label::of(Source::Goal, 1), 0);
        add(&mut album, Label::of(Source::Camera, 2), 2 * SPAN_NS);
        assert!(album.find(&Label::of(Source::Goal, 1)).is_some());
        assert_eq!(album.kept.len(), 1);
    }

    #[test]
    fn client_gets_the_newest_of_each_kind_in_order() {
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

//! LeRobot data sets: round trips, independent readers and writers, and damage.

mod damage;
mod derived;
mod gaps;
mod made;
mod peers;
mod round_trip;

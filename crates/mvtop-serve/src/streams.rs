//! Streams: exposures one after the other, whose objects keep their numbers.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use mvtop_core::estimator::Tracks;

use crate::problem::{Kind, Problem};

/// Streams at once; for one more, the one that was idle longest is forgotten.
const MOST: usize = 64;
/// How long a stream is remembered without an exposure.
const IDLE: Duration = Duration::from_secs(3600);
/// Longest name, bytes.
const LONGEST: usize = 64;

/// What belongs together: a model and a rig, by their indices, and what clients call the stream.
pub type Key = (usize, usize, String);

/// What is remembered of a stream.
#[derive(Debug, Default)]
pub struct Stream {
    pub tracks: Tracks,
    /// Exposures so far.
    pub exposures: u64,
}

/// A stream for those who want to have it, one after the other, in the order in which they came.
pub type Shared = Arc<tokio::sync::Mutex<Stream>>;

/// All streams.
#[derive(Default)]
pub struct Streams(Mutex<HashMap<Key, Known>>);

struct Known {
    stream: Shared,
    used: Instant,
}

impl Known {
    /// Nobody works with it or waits for it.
    fn is_idle(&self) -> bool {
        Arc::strong_count(&self.stream) == 1
    }
}

impl Streams {
    /// The stream of that key, a new one where it is not known.
    pub fn open(&self, key: Key, now: Instant) -> Result<Shared, Problem> {
        let mut all = self.lock();
        forget(&mut all, now);
        if !all.contains_key(&key) && all.len() == MOST {
            let idle = all.iter().filter(|(_, known)| known.is_idle());
            let oldest = idle.min_by_key(|(_, known)| known.used);
            let Some(oldest) = oldest.map(|(key, _)| key.clone()) else {
                let message = format!(
                    "all {MOST} streams are worked on; send this again later, or use fewer"
                );
                return Err(Problem::new(Kind::Busy, message));
            };
            all.remove(&oldest);
        }
        let known = all.entry(key).or_insert_with(|| Known {
            stream: Shared::default(),
            used: now,
        });
        known.used = now;
        Ok(known.stream.clone())
    }

    /// How many are remembered.
    pub fn count(&self, now: Instant) -> usize {
        let mut all = self.lock();
        forget(&mut all, now);
        all.len()
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Key, Known>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Forgets those that were idle too long.
fn forget(all: &mut HashMap<Key, Known>, now: Instant) {
    all.retain(|_, known| !known.is_idle() || now.duration_since(known.used) < IDLE);
}

/// Refuses a name that is none.
pub fn check_name(name: &str) -> Result<(), Problem> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if (1..=LONGEST).contains(&name.len()) && name.chars().all(plain) {
        return Ok(());
    }
    let start: String = name.chars().take(LONGEST).collect();
    Err(Problem::bad(format!(
        "stream: expected a name of 1 to {LONGEST} letters, digits, `-`, `_` and `.`, got `{start}`"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(name: usize) -> Key {
        (0, 0, name.to_string())
    }

    /// Exposures of a stream, of which this is one more.
    fn expose(streams: &Streams, key: Key, now: Instant) -> u64 {
        let stream = streams.open(key, now).unwrap();
        let mut stream = stream.try_lock().unwrap();
        stream.exposures += 1;
        stream.exposures
    }

    #[test]
    fn streams_are_told_apart_by_name_model_and_rig() {
        let (streams, now) = (Streams::default(), Instant::now());
        assert_eq!(expose(&streams, (0, 0, "a".into()), now), 1);
        assert_eq!(expose(&streams, (0, 0, "a".into()), now), 2);
        for other in [(1, 0, "a".into()), (0, 1, "a".into()), (0, 0, "b".into())] {
            assert_eq!(expose(&streams, other, now), 1);
        }
    }

    #[test]
    fn idle_streams_are_forgotten_and_of_too_many_the_oldest() {
        let (streams, start) = (Streams::default(), Instant::now());
        let at = |seconds: usize| start + Duration::from_secs(seconds as u64);
        for number in 0..MOST {
            expose(&streams, key(number), at(number));
        }
        // The oldest one is worked on; the next one makes way.
        let worked_on = streams.open(key(0), at(0)).unwrap();
        assert_eq!(expose(&streams, key(MOST), at(MOST)), 1);
        assert_eq!(streams.count(at(MOST)), MOST);
        assert_eq!(expose(&streams, key(2), at(MOST)), 2);
        assert_eq!(expose(&streams, key(1), at(MOST)), 1);
        let late = at(MOST) + IDLE;
        assert_eq!(streams.count(late), 1);
        drop(worked_on);
        assert_eq!(streams.count(late), 0);
    }

    #[test]
    fn one_more_than_are_worked_on_is_told_to_wait() {
        let (streams, now) = (Streams::default(), Instant::now());
        let all: Vec<Shared> = (0..MOST)
            .map(|number| streams.open(key(number), now).unwrap())
            .collect();
        let refused = streams.open(key(MOST), now).unwrap_err();
        assert_eq!(refused.kind, Kind::Busy);
        drop(all);
        assert!(streams.open(key(MOST), now).is_ok());
    }

    #[test]
    fn names_that_are_none_are_refused() {
        assert!(check_name("cell-1.left_arm").is_ok());
        for name in ["", "a b", "é", "a/b", &"x".repeat(LONGEST + 1)] {
            let refused = check_name(name).unwrap_err();
            assert!(refused.message.contains("expected a name"), "{name}");
        }
    }
}

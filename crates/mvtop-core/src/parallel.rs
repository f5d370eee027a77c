//! Work of a few milliseconds on all threads.

use std::sync::{Mutex, PoisonError};

/// What `of` makes of each item, in their order, on rayon's threads and the caller's.
///
/// Where the caller only waits, as in rayon's own iterators, two threads that are woken at once often
/// share a core for some milliseconds, while the other core idles.
pub fn each<T: Send, R: Send>(items: Vec<T>, of: impl Fn(T) -> R + Sync) -> Vec<R> {
    let threads = rayon::current_num_threads().min(items.len());
    let mut made: Vec<Option<R>> = items.iter().map(|_| None).collect();
    let left = Mutex::new(items.into_iter().zip(&mut made));
    let next = || left.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        while let Some((item, made)) = next() {
            *made = Some(of(item));
        }
    };
    rayon::in_place_scope(|scope| {
        for _ in 1..threads {
            scope.spawn(|_| work());
        }
        work();
    });
    drop(left);
    made.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::each;

    #[test]
    fn answers_come_in_the_order_of_the_items() {
        for count in [0, 1, 2, 100] {
            let squares: Vec<usize> = (0..count).map(|n| n * n).collect();
            assert_eq!(each((0..count).collect(), |n| n * n), squares);
        }
    }

    #[test]
    fn items_may_be_what_is_written_to() {
        let mut rows = [[0; 3]; 5];
        each(rows.iter_mut().enumerate().collect(), |(n, row)| {
            row.fill(n)
        });
        assert_eq!(rows[4], [4; 3]);
    }
}

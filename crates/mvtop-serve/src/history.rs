//! The last exposures, for the page.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::exposure::{Exposure, Upload};

/// Exposures that are remembered.
const MOST: usize = 100;

/// The last exposures, the newest last, with the images of as many as there is room for.
pub struct History {
    entries: VecDeque<Entry>,
    most_bytes: usize,
}

/// An exposure that is remembered.
#[derive(Clone)]
pub struct Entry {
    pub exposure: Arc<Exposure>,
    /// `None` where there was no room for them any more.
    pub uploads: Option<Arc<Vec<Upload>>>,
}

impl Entry {
    fn bytes(&self) -> usize {
        let uploads = self.uploads.iter().flat_map(|uploads| uploads.iter());
        uploads.map(|upload| upload.bytes.len()).sum()
    }
}

impl History {
    /// - `most_bytes`: of images
    pub fn new(most_bytes: usize) -> Self {
        Self {
            entries: VecDeque::new(),
            most_bytes,
        }
    }

    pub fn add(&mut self, exposure: Arc<Exposure>, uploads: Arc<Vec<Upload>>) {
        self.entries.push_back(Entry {
            exposure,
            uploads: Some(uploads),
        });
        while self.entries.len() > MOST {
            self.entries.pop_front();
        }
        let mut bytes: usize = self.entries.iter().map(Entry::bytes).sum();
        for entry in &mut self.entries {
            if bytes <= self.most_bytes {
                break;
            }
            bytes -= entry.bytes();
            entry.uploads = None;
        }
    }

    /// The newest first.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().rev()
    }

    /// The exposure of that number.
    pub fn get(&self, number: u64) -> Option<Entry> {
        self.entries()
            .find(|entry| entry.exposure.number == number)
            .cloned()
    }

    /// The newest exposure of a model and a rig, and of a stream if one is named.
    pub fn last_of(&self, model: usize, rig: usize, stream: Option<&str>) -> Option<Entry> {
        let of = |entry: &&Entry| {
            let exposure = &entry.exposure;
            (exposure.model, exposure.rig) == (model, rig)
                && (stream.is_none() || exposure.stream.as_deref() == stream)
        };
        self.entries().find(of).cloned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exposure::Layout;

    fn add(history: &mut History, number: u64, bytes: usize) {
        let upload = Upload {
            camera: 0,
            bytes: vec![0; bytes].into(),
            layout: Layout::File,
        };
        history.add(Arc::new(Exposure::failed(number)), Arc::new(vec![upload]));
    }

    #[test]
    fn oldest_exposures_go_and_oldest_images_before_them() {
        let mut history = History::new(1000);
        for number in 1..=200 {
            add(&mut history, number, 100);
        }
        assert_eq!(history.entries().count(), MOST);
        assert_eq!(history.last_of(0, 0, None).unwrap().exposure.number, 200);
        assert!(history.get(100).is_none() && history.get(101).is_some());
        assert!(history.last_of(0, 1, None).is_none() && history.last_of(1, 0, None).is_none());
        let with_images = history.entries().filter(|entry| entry.uploads.is_some());
        assert_eq!(with_images.count(), 10);
        add(&mut history, 201, 5000);
        assert!(history.entries().all(|entry| entry.uploads.is_none()));
    }
}

//! From images to an answer, however they came: read [`Service::expose`].

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use mvtop_core::cancel::Cancel;
use mvtop_core::estimator::MOST_GIVEN;
use mvtop_core::{Request, ViewImage};
use tokio::sync::{OwnedMutexGuard, Semaphore, oneshot};

use crate::config::Config;
use crate::exposure::{Exposure, Found, Upload, decode_all};
use crate::history::History;
use crate::metrics::Metrics;
use crate::problem::{Kind, Problem};
use crate::queue::{Place, Queue};
use crate::record::Recorder;
use crate::station::{self, Model, NamedRig};
use crate::streams::{self, Stream, Streams};

/// Clients that may send images at once: each of them may fill memory up to the largest body.
pub const MOST_UPLOADS: usize = 16;

/// All that is shared by those who ask.
pub struct Service {
    config: Config,
    rigs: Vec<NamedRig>,
    /// There once all are loaded and tested.
    models: OnceLock<Vec<Model>>,
    pub metrics: Metrics,
    history: Mutex<History>,
    recorder: Option<Recorder>,
    queue: Queue,
    streams: Streams,
    /// Places of clients that send images.
    pub uploads: Arc<Semaphore>,
    stopping: AtomicBool,
    exposures: AtomicU64,
    requests: AtomicU64,
    started: u64,
}

/// Ends the work for an answer when it is dropped, as nobody waits for it any more.
#[derive(Default)]
struct Awaited(Cancel);

impl Drop for Awaited {
    fn drop(&mut self) {
        self.0.ask();
    }
}

/// What is asked of some images.
pub struct Asked {
    /// Of the request, for logs and answers.
    pub id: String,
    /// Index of the model.
    pub model: usize,
    /// Index of the rig.
    pub rig: usize,
    /// Name of the stream that the exposure belongs to, if any.
    pub stream: Option<String>,
    pub request: Request,
    pub began: Instant,
}

impl Service {
    /// Loads the rigs; models come by [`Service::load`].
    pub fn new(config: Config) -> Result<Self, String> {
        station::check_names("model", &config.models)?;
        station::check_names("rig", &config.rigs)?;
        let recorder = config.record.as_ref();
        let recorder = recorder
            .map(|record| Recorder::new(record, &config.options))
            .transpose()?;
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        Ok(Self {
            rigs: station::load_rigs(&config.rigs)?,
            models: OnceLock::new(),
            metrics: Metrics::new(),
            history: Mutex::new(History::new(config.history_bytes)),
            recorder,
            queue: Queue::new(config.waiting)?,
            streams: Streams::default(),
            uploads: Arc::new(Semaphore::new(MOST_UPLOADS)),
            stopping: AtomicBool::new(false),
            exposures: AtomicU64::new(0),
            requests: AtomicU64::new(0),
            started: since.map_or(0, |since| since.as_millis() as u64),
            config,
        })
    }

    /// Loads all models and runs their self-tests.
    pub fn load(&self) -> Result<(), String> {
        let load =
            |(name, folder): &(String, PathBuf)| Model::load(name, folder, &self.config.options);
        let models = self.config.models.iter().map(load);
        let models = models.collect::<Result<Vec<_>, _>>()?;
        // Once for a service.
        let _ = self.models.set(models);
        Ok(())
    }

    pub fn config(&self) -> &Config {
        &self.config
    }

    pub fn rigs(&self) -> &[NamedRig] {
        &self.rigs
    }

    /// The models, once they are loaded, and until the service ends.
    pub fn models(&self) -> Result<&[Model], Problem> {
        if self.stopping.load(Ordering::Relaxed) {
            let message = "the service is stopping; send this again later";
            return Err(Problem::new(Kind::NotReady, message));
        }
        self.models.get().map(Vec::as_slice).ok_or_else(|| {
            let message = "the models are still being loaded; send this again later";
            Problem::new(Kind::NotReady, message)
        })
    }

    pub fn model(&self, name: Option<&str>) -> Result<usize, Problem> {
        let models = self.models()?;
        station::find(
            "model",
            name,
            models.iter().map(|model| model.name.as_str()),
        )
    }

    pub fn rig(&self, name: Option<&str>) -> Result<usize, Problem> {
        station::find("rig", name, self.rigs.iter().map(|rig| rig.name.as_str()))
    }

    pub fn history(&self) -> MutexGuard<'_, History> {
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn queue_length(&self) -> usize {
        self.queue.length()
    }

    /// How many streams are remembered.
    pub fn streams(&self) -> usize {
        self.streams.count(Instant::now())
    }

    /// An id for a request that brought none: no other of this service or the next has it.
    pub fn next_id(&self) -> String {
        let number = self.requests.fetch_add(1, Ordering::Relaxed);
        format!("{:x}-{number:x}", self.started)
    }

    /// Waits until no exposure is worked on or waits.
    pub async fn worked_off(&self) {
        self.queue.worked_off().await;
    }

    /// Takes no new work from now on.
    pub fn stop(&self) {
        self.stopping.store(true, Ordering::Relaxed);
    }

    /// Waits for what was begun.
    pub fn finish(&self) {
        self.queue.finish();
        if let Some(recorder) = &self.recorder {
            recorder.finish();
        }
    }

    /// Takes a place in the queue, before images are decoded.
    pub fn enter(&self) -> Result<Place, Problem> {
        self.queue.enter()
    }

    /// Decodes the images, waits for the thread that predicts, and answers. Those of a stream come one
    /// after the other.
    ///
    /// The work ends with the future: with its time, and where it is dropped as the client has gone.
    pub async fn expose(
        self: &Arc<Self>,
        place: Place,
        mut asked: Asked,
        uploads: Vec<Upload>,
    ) -> Result<Arc<Exposure>, Problem> {
        let request = &mut asked.request;
        if request.base_from_world.is_none() {
            request.base_from_world = self.config.base_from_world;
        }
        let model = &self.models()?[asked.model];
        let rig = &self.rigs[asked.rig].rig;
        request.check(model.bundle(), rig, model.grasps.is_some())?;
        let boxes = request.boxes.as_ref().map_or(0, Vec::len);
        // Told before images are decoded.
        if boxes > MOST_GIVEN {
            return Err(Problem::bad(format!(
                "boxes: expected {MOST_GIVEN} objects at most, got {boxes}; send them in several requests"
            )));
        }
        let stream = match &asked.stream {
            Some(name) => {
                streams::check_name(name)?;
                let key = (asked.model, asked.rig, name.clone());
                Some(self.streams.open(key, Instant::now())?)
            }
            None => None,
        };
        let request_time = self.config.request_time;
        let awaited = Awaited::default();
        let answered = async {
            let turn = match stream {
                Some(stream) => Some(stream.lock_owned().await),
                None => None,
            };
            let cancel = awaited.0.clone();
            self.submit(place, asked, uploads, turn, cancel).await
        };
        match tokio::time::timeout(request_time, answered).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(_)) => {
                let message = "the service is stopping; send this again later";
                Err(Problem::new(Kind::NotReady, message))
            }
            Err(_) => Err(Problem::new(
                Kind::TimedOut,
                format!(
                    "expected an answer within {} s, it takes longer; raise --request-seconds, or send fewer at once",
                    request_time.as_secs()
                ),
            )),
        }
    }

    /// Decodes the images in another thread, and then gives them to the one that predicts.
    ///
    /// - `turn`: the stream that they belong to, until they are answered
    /// - `cancel`: ends it
    fn submit(
        self: &Arc<Self>,
        place: Place,
        asked: Asked,
        uploads: Vec<Upload>,
        mut turn: Option<OwnedMutexGuard<Stream>>,
        cancel: Cancel,
    ) -> oneshot::Receiver<Result<Arc<Exposure>, Problem>> {
        let uploads = Arc::new(uploads);
        let (reply, answer) = oneshot::channel();
        let service = self.clone();
        tokio::task::spawn_blocking(move || {
            if cancel.is_asked() {
                return;
            }
            let rig = &service.rigs[asked.rig].rig;
            let images = match decode_all(&uploads, rig) {
                Ok(images) => images,
                Err(error) => {
                    let problem = Problem::from(error);
                    service.note(asked, uploads, Err(problem.message.clone()));
                    drop(place);
                    let _ = reply.send(Err(problem));
                    return;
                }
            };
            let queue = service.clone();
            let task = move |place| {
                if cancel.is_asked() {
                    return;
                }
                let predict = || service.predict(&asked, &images, turn.as_deref_mut());
                let done = cancel.scope(predict);
                let answer = match done {
                    Ok(found) => Ok(service.note(asked, uploads, Ok(found))),
                    Err(problem) => {
                        service.note(asked, uploads, Err(problem.message.clone()));
                        Err(problem)
                    }
                };
                drop(place);
                let _ = reply.send(answer);
            };
            // Else the reply is dropped, which says so.
            let _ = queue.queue.submit(place, Box::new(task));
        });
        answer
    }

    /// One prediction, whatever happens in it.
    fn predict(
        &self,
        asked: &Asked,
        images: &[ViewImage],
        mut stream: Option<&mut Stream>,
    ) -> Result<Found, Problem> {
        let predict = || -> Result<Found, Problem> {
            let models = self.models.get().map(Vec::as_slice).unwrap_or_default();
            let Some(model) = models.get(asked.model) else {
                return Err(Problem::new(Kind::NotReady, "the model is not loaded"));
            };
            let rig = &self.rigs[asked.rig].rig;
            let (estimator, grasps) = (&model.estimator, model.grasps.as_ref());
            let tracks = stream.as_mut().map(|stream| &mut stream.tracks);
            let request = &asked.request;
            let all = request.find_all(estimator, grasps, rig, images, tracks)?;
            let answer = request.choose(all.clone(), estimator.bundle(), grasps, rig)?;
            let mut json = answer.report.to_json()?;
            json.push('\n');
            Ok(Found {
                json,
                accepted: answer.is_accepted(request),
                prediction: answer.prediction,
                all,
                stream_exposures: stream.map(|stream| {
                    stream.exposures += 1;
                    stream.exposures
                }),
            })
        };
        catch_unwind(AssertUnwindSafe(predict)).unwrap_or_else(|_| {
            let message = "the prediction failed by an error of the program; send the images with a bug report";
            Err(Problem::new(Kind::Internal, message))
        })
    }

    /// Counts an exposure and remembers it.
    fn note(
        &self,
        asked: Asked,
        uploads: Arc<Vec<Upload>>,
        outcome: Result<Found, String>,
    ) -> Arc<Exposure> {
        if let Ok(found) = &outcome {
            self.metrics.found(&found.prediction, asked.began.elapsed());
        }
        let exposure = Arc::new(Exposure {
            number: self.exposures.fetch_add(1, Ordering::Relaxed) + 1,
            id: asked.id,
            time: SystemTime::now(),
            model: asked.model,
            rig: asked.rig,
            stream: asked.stream,
            request: asked.request,
            took_ms: asked.began.elapsed().as_secs_f64() * 1e3,
            outcome,
        });
        self.history().add(exposure.clone(), uploads.clone());
        if let (Some(recorder), Some(record)) = (&self.recorder, &self.config.record)
            && let Some(doubt) = exposure.doubt(record.below)
            && let Some(model) = self.models.get().and_then(|all| all.get(exposure.model))
        {
            let rig = self.rigs[exposure.rig].rig.clone();
            let sent = recorder.keep(exposure.clone(), uploads, rig, &model.folder, doubt);
            self.metrics.recorded(sent);
        }
        exposure
    }
}

//! The line protocol over TCP, for robot controllers: a line asks, lines answer, `END` ends.
//!
//! `docs/how-to/serve.md` describes it.

mod reply;

use std::ffi::OsStr;
use std::future::pending;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use mvtop_core::{Request, Rig};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpListener;
use tokio::sync::watch;

use self::reply::Format;
use crate::accept::{self, Known};
use crate::client::Client;
use crate::exposure::{Exposure, Layout, Upload};
use crate::http::is_token;
use crate::log;
use crate::problem::{self, Kind, Problem};
use crate::service::{Asked, Service};

/// Controllers at once; further ones wait to be accepted.
const MOST_CONNECTIONS: usize = 16;
/// Longest line that is read, bytes.
const LONGEST: u64 = 4096;
/// How long the rest of a connection is read that ends.
const REST_TIME: Duration = Duration::from_secs(5);
/// How long a connection may be silent.
const SILENCE: Duration = Duration::from_secs(600);
/// Settings beside those of a request.
const NAMES: [&str; 6] = ["model", "rig", "stream", "max_age_s", "unit", "rotation"];
/// How the files of a camera may end, in any case.
const ENDINGS: [&str; 6] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp"];
/// How far the clock of who writes images may be ahead, seconds.
const AHEAD_S: f64 = 1.0;
/// Largest image file.
const MOST_BYTES: u64 = 1 << 29;

/// Serves until `stopped`, then until what was asked is answered.
pub async fn serve(service: Arc<Service>, listener: TcpListener, stopped: watch::Receiver<bool>) {
    let talk = |client, known| {
        let (service, stopped) = (service.clone(), stopped.clone());
        async move {
            // What a client does to its connection is its own matter.
            let _ = talk(&service, client, known, stopped).await;
        }
    };
    accept::each(listener, MOST_CONNECTIONS, stopped.clone(), talk).await;
}

async fn talk(
    service: &Arc<Service>,
    client: Client,
    known: Known,
    mut stopped: watch::Receiver<bool>,
) -> io::Result<()> {
    let mut client = BufReader::new(client);
    loop {
        let mut line = Vec::new();
        let mut bounded = (&mut client).take(LONGEST);
        let got = tokio::select! {
            got = tokio::time::timeout(SILENCE, bounded.read_until(b'\n', &mut line)) => got,
            _ = stopped.changed() => return Ok(()),
        };
        let Ok(Ok(1..)) = got else { return Ok(()) };
        let whole = line.ends_with(b"\n");
        let text = String::from_utf8_lossy(&line).trim().to_owned();
        if whole && text.is_empty() {
            continue;
        }
        let quits = text.eq_ignore_ascii_case("QUIT");
        let said = match whole {
            false => Err(Problem::bad(format!(
                "line: expected {LONGEST} bytes at most, and its end"
            ))),
            true if quits => Ok("OK\n".to_owned()),
            true => tokio::select! {
                // What needs no time is answered even so.
                biased;
                said = said(service, &text, &known) => said,
                () = gone(&mut client) => return Ok(()),
            },
        };
        let answer = match said {
            Ok(text) => format!("{text}END\n"),
            Err(problem) => {
                log::line(&format!("line {} {}", problem.kind.code(), problem.message));
                format!("ERROR {} {}\nEND\n", problem.kind.code(), problem.message)
            }
        };
        client.write_all(answer.as_bytes()).await?;
        client.flush().await?;
        if quits || !whole {
            return close(client).await;
        }
    }
}

/// Closes the connection once the client has read the answer. One that is closed with bytes unread is
/// reset, and the answer may be lost: so what the client still sends is read and forgotten, for a while.
async fn close(mut client: BufReader<Client>) -> io::Result<()> {
    client.shutdown().await?;
    let mut nowhere = tokio::io::sink();
    let rest = tokio::io::copy(&mut client, &mut nowhere);
    let _ = tokio::time::timeout(REST_TIME, rest).await;
    Ok(())
}

/// Ends when the client closes its connection; lines that it sends ahead are kept.
async fn gone(client: &mut BufReader<Client>) {
    if client.fill_buf().await.is_ok_and(|ahead| !ahead.is_empty()) {
        pending().await
    }
}

/// The answer to a line, without its end.
async fn said(service: &Arc<Service>, text: &str, known: &Known) -> Result<String, Problem> {
    let mut words = text.split_whitespace();
    let verb = words.next().unwrap_or_default();
    let shows = verb.eq_ignore_ascii_case("TOKEN");
    match &service.config().token {
        None => known.note(),
        Some(token) if shows && is_token(words.next().unwrap_or_default(), token) => {
            known.note();
            return Ok("OK\n".into());
        }
        Some(_) if known.is_so() && !shows => {}
        Some(_) => {
            let message =
                "expected the line `TOKEN ...` with this service's token first; ask who runs it";
            return Err(Problem::new(Kind::Unauthorized, message));
        }
    }
    let order = Order::read(words)?;
    match verb.to_ascii_uppercase().as_str() {
        "FIND" => find(service, order).await,
        "LAST" => last(service, order),
        _ => Err(Problem::bad(format!(
            "`{verb}`: expected FIND, LAST, TOKEN or QUIT"
        ))),
    }
}

/// What follows a verb.
#[derive(Default)]
struct Order {
    model: Option<String>,
    rig: Option<String>,
    stream: Option<String>,
    /// Oldest exposure that is wanted, seconds.
    most_age_s: Option<f64>,
    format: Format,
    request: Request,
    /// Names of the settings of the request that were given.
    given: Vec<String>,
}

impl Order {
    fn read<'a>(words: impl Iterator<Item = &'a str>) -> Result<Self, Problem> {
        let (mut order, mut seen) = (Self::default(), Vec::new());
        for word in words {
            let wrong = || Problem::bad(format!("`{word}`: expected NAME=VALUE, as in most=1"));
            let (name, value) = word.split_once('=').ok_or_else(wrong)?;
            problem::check_once(name, &mut seen)?;
            match name {
                "model" => order.model = Some(value.to_owned()),
                "rig" => order.rig = Some(value.to_owned()),
                "stream" => {
                    order.stream = Some(value.to_owned());
                    order.format.ids = true;
                }
                "max_age_s" => {
                    let age = value.parse().ok().filter(|age: &f64| *age >= 0.0);
                    let wrong =
                        || Problem::bad(format!("max_age_s: expected seconds, got `{value}`"));
                    order.most_age_s = Some(age.ok_or_else(wrong)?);
                }
                "unit" | "rotation" => order.format.set(name, value)?,
                _ => {
                    problem::check_setting(name, &NAMES)?;
                    order.request.set(name, value)?;
                    order.given.push(name.to_owned());
                }
            }
        }
        Ok(order)
    }

    /// Indices of the model and the rig that are asked for, or of the first ones.
    fn model_and_rig(&self, service: &Service) -> Result<(usize, usize), Problem> {
        let model = service.model(self.model.as_deref())?;
        Ok((model, service.rig(self.rig.as_deref())?))
    }
}

/// Looks at the images in the folder of the camera program.
async fn find(service: &Arc<Service>, mut order: Order) -> Result<String, Problem> {
    // Also counted where its client goes before it is done.
    let mut counted = service.metrics.request();
    let exposure = expose(service, &mut order).await;
    counted.outcome = match &exposure {
        Ok(_) => "ok",
        Err(problem) => problem.kind.code(),
    };
    let exposure = exposure?;
    let found = exposure
        .outcome
        .as_ref()
        .map_err(|problem| Problem::new(Kind::Internal, problem))?;
    order.format.told(
        &exposure,
        &found.prediction,
        &exposure.request,
        &service.rigs()[exposure.rig].rig,
    )
}

/// An exposure of these images.
async fn expose(service: &Arc<Service>, order: &mut Order) -> Result<Arc<Exposure>, Problem> {
    let began = Instant::now();
    let (model, rig) = order.model_and_rig(service)?;
    let config = service.config().line.as_ref();
    let folder = config.and_then(|line| line.images.clone()).ok_or_else(|| {
        Problem::bad("FIND: expected a folder with images, got none; start the service with --line-images DIR, or ask for LAST")
    })?;
    let place = service.enter()?;
    let cameras = service.rigs()[rig].rig.clone();
    let most_age_s = order.most_age_s;
    let read = tokio::task::spawn_blocking(move || images(&folder, &cameras, most_age_s));
    let failed = |cause| Problem::new(Kind::Internal, format!("cannot read images: {cause}"));
    let uploads = read.await.map_err(failed)??;
    let asked = Asked {
        id: service.next_id(),
        model,
        rig,
        stream: order.stream.take(),
        request: std::mem::take(&mut order.request),
        began,
    };
    service.expose(place, asked, uploads).await
}

/// The images of a folder that are named after cameras.
fn images(folder: &Path, rig: &Rig, most_age_s: Option<f64>) -> Result<Vec<Upload>, Problem> {
    let mut uploads = Vec::new();
    for (index, path) in files(folder, rig)? {
        let age_s = age_s(&path);
        let is_old = |most: &f64| !age_s.is_some_and(|age| age <= *most && age >= -AHEAD_S);
        if let Some(most) = most_age_s.filter(is_old) {
            let got = match age_s {
                None => "one of unknown age".to_owned(),
                Some(age) if age < 0.0 => format!("one from {:.1} s ahead, set the clocks", -age),
                Some(age) => format!("one of {age:.1} s"),
            };
            return Err(Problem::bad(format!(
                "image of camera `{}`: expected one of at most {most} s, got {got}; look at the camera program",
                rig.cameras()[index].id()
            )));
        }
        let bytes = mvtop_core::file::read(&path, MOST_BYTES)?.into();
        uploads.push(Upload {
            camera: index,
            bytes,
            layout: Layout::File,
        });
    }
    if uploads.is_empty() {
        let ids: Vec<&str> = rig.cameras().iter().map(|camera| camera.id()).collect();
        return Err(Problem::bad(format!(
            "{}: expected images that are named after cameras ({}), got none",
            folder.display(),
            ids.join(", ")
        )));
    }
    Ok(uploads)
}

/// The file of each camera that has one, with the camera's index, in the rig's order.
fn files(folder: &Path, rig: &Rig) -> Result<Vec<(usize, PathBuf)>, Problem> {
    let failed = |error| Problem::bad(format!("{}: {error}", folder.display()));
    let mut files: Vec<(usize, PathBuf)> = Vec::new();
    for entry in folder.read_dir().map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let text = |part: Option<&OsStr>| part.and_then(OsStr::to_str).map(str::to_owned);
        let (name, ending) = (text(path.file_stem()), text(path.extension()));
        let ending = ending.map(|ending| ending.to_ascii_lowercase());
        let is_image = ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()));
        let Some(index) = name.and_then(|name| rig.index_of(&name)) else {
            continue;
        };
        if !is_image || !path.is_file() {
            continue;
        }
        if let Some((_, other)) = files.iter().find(|(camera, _)| *camera == index) {
            return Err(Problem::bad(format!(
                "{}: expected one image of each camera, got {} and {}; remove the older one",
                folder.display(),
                other.file_name().unwrap_or_default().display(),
                path.file_name().unwrap_or_default().display()
            )));
        }
        files.push((index, path));
    }
    files.sort();
    Ok(files)
}

/// Seconds since a file was changed, below 0 where that is to come; `None` where it is not known.
fn age_s(path: &Path) -> Option<f64> {
    let changed = path.metadata().and_then(|about| about.modified()).ok()?;
    Some(match changed.elapsed() {
        Ok(age) => age.as_secs_f64(),
        Err(ahead) => -ahead.duration().as_secs_f64(),
    })
}

/// Chooses from the last exposure, however it came.
fn last(service: &Arc<Service>, mut order: Order) -> Result<String, Problem> {
    let settled = ["reference", "min_views", "refine"];
    if let Some(name) = order
        .given
        .iter()
        .find(|name| settled.contains(&name.as_str()))
    {
        return Err(Problem::bad(format!(
            "LAST: `{name}` was settled with the exposure; ask for FIND"
        )));
    }
    let (model, rig) = order.model_and_rig(service)?;
    let of_stream = order.stream.as_deref();
    let nothing = || {
        let message = match of_stream {
            None => "LAST: no exposure yet of this model and rig; send images to /v1/predict first"
                .to_owned(),
            Some(name) => {
                format!("LAST: no exposure of stream `{name}` among the last hundred; ask for FIND")
            }
        };
        Problem::new(Kind::NotFound, message)
    };
    let entry = service
        .history()
        .last_of(model, rig, of_stream)
        .ok_or_else(nothing)?;
    let exposure: &Exposure = &entry.exposure;
    let age_s = exposure.time.elapsed().map_or(0.0, |age| age.as_secs_f64());
    if let Some(most) = order.most_age_s.filter(|most| age_s > *most) {
        return Err(Problem::new(
            Kind::NotFound,
            format!(
                "LAST: expected an exposure of at most {most} s, the last one is {age_s:.1} s old"
            ),
        ));
    }
    let found = exposure.outcome.as_ref();
    let found = found.map_err(|problem| {
        Problem::new(
            Kind::NotFound,
            format!("LAST: the last exposure failed: {problem}"),
        )
    })?;
    looked_for(&order.request, &exposure.request)?;
    let model = &service.models()?[exposure.model];
    let rig = &service.rigs()[exposure.rig].rig;
    let request = &mut order.request;
    if request.base_from_world.is_none() {
        request.base_from_world = exposure.request.base_from_world;
    }
    request.check(model.bundle(), rig, model.grasps.is_some())?;
    let grasps = model.grasps.as_ref();
    let answer = request.choose(found.all.clone(), model.bundle(), grasps, rig)?;
    order
        .format
        .told(exposure, &answer.prediction, &order.request, rig)
}

/// Refuses what an exposure was not asked for: it cannot be chosen from it.
fn looked_for(wanted: &Request, asked: &Request) -> Result<(), Problem> {
    let other = |class: &&String| {
        asked
            .classes
            .as_ref()
            .is_some_and(|all| !all.contains(*class))
    };
    if let Some(class) = wanted.classes.iter().flatten().find(other) {
        return Err(Problem::bad(format!(
            "LAST: `{class}` was not looked for in the last exposure; ask for FIND"
        )));
    }
    if wanted.why && !(asked.why || asked.classes.is_some()) {
        return Err(Problem::bad(
            "LAST: `why` was not asked of the last exposure; ask for FIND",
        ));
    }
    Ok(())
}

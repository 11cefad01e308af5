//! A line that is looked at and not configured: who is there, what each SubDevice says of itself, and its objects.

mod eeprom;

use std::{
    pin::Pin,
    sync::Arc,
    thread::{self, JoinHandle},
};

use smol::channel::{Receiver, Sender, bounded, unbounded};

use crate::{
    bus::{
        device::serve_mailbox,
        error::{AlStatus, NetworkError, OfDevice},
        line::{self, Found},
        log::{Log, Subscriber},
        network::supervisor,
        requests::{BusLoop, Context, Reactor, WaitStrategy},
        watch::{Control, Guard},
    },
    coe::{DriveId, Emergencies, ErrorTexts, SdoHandle},
    esc,
    link::Link,
    sii::Sii,
    wakes::Wakes,
};

pub use eeprom::{EepromAccessError, EepromContent, EepromWritten, ImageKind};

/// Bit 2 of the features: distributed clocks; bit 3: of 64 bits.
const CLOCK: u8 = 0x04;
const CLOCK_64: u8 = 0x08;

/// The SubDevices of a line in PREOP, unconfigured, with their mailboxes served.
///
/// Made by [`NetworkBuilder::scan`](crate::bus::NetworkBuilder::scan). When it is dropped the SubDevices go to INIT and the bus
/// thread ends.
///
/// ```no_run
/// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
/// use servocrab::Network;
/// let line = Network::builder().interface("eth0").scan().await?;
/// for device in line.devices() {
///     println!("{}, alias {}", device.id, device.alias);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Line {
    devices: Vec<LineDevice>,
    control: Arc<Control>,
    over: Receiver<()>,
    thread: Option<JoinHandle<()>>,
    work: Sender<Work>,
}

/// Something to be done on the bus thread.
type Work = Box<dyn FnOnce(Context) -> Pin<Box<dyn Future<Output = ()>>> + Send>;

/// A SubDevice of a [`Line`].
#[derive(Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct LineDevice {
    /// Its place, its name and what it says it is.
    pub id: DriveId,
    /// Its configured station alias (0012h); 0 if none.
    pub alias: u16,
    /// The AL state in which it was found, before it was brought into PREOP.
    pub found_in: AlStatus,
    /// The bits of its distributed clock, 32 or 64; none if it has none.
    pub clock_bits: Option<u8>,
    /// Its whole SII, if it could be read.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub sii: Option<Sii>,
    /// Access to its objects, if it is in PREOP and has CoE.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub sdo: Option<SdoHandle>,
    /// Its emergencies, if it has CoE.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub emergencies: Option<Emergencies>,
    /// Why it is not in PREOP, or its SII could not be read. Serialised as its text.
    #[cfg_attr(feature = "serde", serde(serialize_with = "as_text"))]
    pub problem: Option<NetworkError>,
}

#[cfg(feature = "serde")]
fn as_text<S: serde::Serializer>(
    problem: &Option<NetworkError>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    match problem {
        Some(problem) => serializer.collect_str(problem),
        None => serializer.serialize_none(),
    }
}

impl Line {
    /// The SubDevices, in the line's order.
    #[must_use]
    pub fn devices(&self) -> &[LineDevice] {
        &self.devices
    }

    /// Sends the SubDevices to INIT and ends the bus thread.
    pub async fn close(mut self) {
        self.control.request_shutdown();
        let _ = self.over.recv().await;
        self.join();
    }

    /// Does this on the bus thread. None if that has ended.
    async fn on_bus<T, F>(&self, work: impl FnOnce(Context) -> F + Send + 'static) -> Option<T>
    where
        T: Send + 'static,
        F: Future<Output = T> + 'static,
    {
        let (answer, answered) = bounded(1);
        let work: Work = Box::new(move |context| {
            Box::pin(async move {
                // Nobody takes it when the program has given up meanwhile.
                let _ = answer.try_send(work(context).await);
            })
        });
        self.work.try_send(work).ok()?;
        self.control.waiters.relay(answered.recv()).await.ok()
    }

    fn join(&mut self) {
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!(target: crate::log_target::BUS, "the bus thread has panicked");
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.control.request_shutdown();
        self.join();
    }
}

/// Looks at the line on this link, on a thread of its own.
pub(in crate::bus) async fn scan(link: Box<dyn Link + Send>) -> Result<Line, NetworkError> {
    let (wakes, wakes_end) =
        Wakes::start(None).map_err(|error| NetworkError::Thread(error.to_string()))?;
    let control = Control::new(0, wakes);
    control.set_waker(link.waker());
    let (send_found, found) = bounded(1);
    let (alive, over) = bounded(1);
    let (work, asked) = unbounded();
    let shared = Arc::clone(&control);
    let subscriber = Subscriber::current();
    // A caller that drops the future ends the scan.
    let mut guard = Guard::new(Arc::clone(&control));
    let thread = thread::Builder::new()
        .name("servocrab-bus".into())
        .spawn(move || {
            let reactor = Reactor::new(
                link,
                WaitStrategy::Block,
                &shared.counters,
                &shared.wakes,
                Log::default(),
            );
            let context = reactor.context().clone();
            if let Some(task) = context.spawn(life(context.clone(), shared, send_found, asked)) {
                task.detach();
            }
            subscriber.of(|| BusLoop::new(reactor, None, alive, wakes_end).run());
        })
        .map_err(|error| NetworkError::Thread(error.to_string()))?;
    guard.watch(thread);
    let ended = || NetworkError::Thread("it ended before the line was scanned".into());
    let found = control.waiters.relay(found.recv()).await;
    let devices = match found.unwrap_or_else(|_| Err(ended())) {
        Ok(devices) => devices,
        Err(error) => {
            guard.gone(&over).await;
            return Err(error);
        }
    };
    let (_, thread) = guard.release();
    Ok(Line {
        devices,
        control,
        over,
        thread,
        work,
    })
}

type Scanned = Result<Vec<LineDevice>, NetworkError>;

async fn life(
    context: Context,
    control: Arc<Control>,
    found: Sender<Scanned>,
    asked: Receiver<Work>,
) {
    let devices = smol::future::or(async { Some(look(&context).await) }, async {
        supervisor::given_up(&context, &control).await;
        None
    });
    if let Some(devices) = devices.await {
        let goes_on = devices.is_ok();
        if found.send(devices).await.is_ok() && goes_on {
            let work = async {
                while let Ok(work) = asked.recv().await {
                    work(context.clone()).await;
                }
            };
            smol::future::or(work, supervisor::given_up(&context, &control)).await;
        }
    }
    supervisor::leave(&context).await;
    context.end();
}

async fn look(context: &Context) -> Scanned {
    let mut before = Vec::new();
    let line = line::discover_each(context, Some(&mut before)).await?;
    let tasks: Option<Vec<_>> = line
        .into_iter()
        .zip(0..)
        .zip(before)
        .map(|((found, position), found_in)| {
            context.spawn(device(context.clone(), found, position, found_in))
        })
        .collect();
    let tasks = tasks.ok_or_else(|| NetworkError::Thread("the bus loop is gone".into()))?;
    let mut devices = Vec::new();
    for task in tasks {
        devices.push(task.await?);
    }
    Ok(devices)
}

/// What there is to know of one SubDevice.
async fn device(
    context: Context,
    found: Result<Found, NetworkError>,
    position: u16,
    found_in: AlStatus,
) -> Result<LineDevice, NetworkError> {
    let registers = &context.registers;
    let [features, _] = registers
        .read_at(position, esc::FEATURES)
        .await
        .map_err(NetworkError::Line)?;
    let alias = registers
        .read_at(position, esc::STATION_ALIAS)
        .await
        .map_err(NetworkError::Line)?;
    let mut device = LineDevice {
        id: DriveId {
            position,
            name: String::new(),
            identity: crate::sii::Identity::default(),
        },
        alias: u16::from_le_bytes(alias),
        found_in,
        clock_bits: (features & CLOCK != 0).then_some(if features & CLOCK_64 != 0 {
            64
        } else {
            32
        }),
        sii: None,
        sdo: None,
        emergencies: None,
        problem: None,
    };
    let mut found = match found {
        Ok(found) => found,
        Err(problem) => {
            if let NetworkError::Drive { drive, .. } = &problem {
                device.id = drive.clone();
            }
            device.problem = Some(problem);
            return Ok(device);
        }
    };
    device.id = found.id.clone();
    device.problem = found.read_whole_sii(registers).await.of(&found.id).err();
    device.sii = Some(Sii::clone(&found.sii));
    if let Err(problem) = found.enter_pre_op(registers).await.of(&found.id) {
        device.problem = Some(problem);
        return Ok(device);
    }
    if let Some(mailbox) = serve_mailbox(&context, &found, ErrorTexts::default()) {
        device.sdo = Some(mailbox.sdo);
        device.emergencies = Some(mailbox.emergencies);
    }
    Ok(device)
}

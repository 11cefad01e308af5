//! What handles of an axis must know, and the two ends that come of it: one for the program, one for the cycle's owner.

use core::{fmt, future::Future, pin::Pin};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use crate::{
    StopRequest,
    axis::{AxisCore, AxisFields, Snapshot},
    coe::{AxisOffset, ErrorTexts, ObjectAddress, SdoError, Transfer},
    pdo_map::Layout,
    units::{AxisScale, AxisUnit},
};

use super::{
    AxisError, AxisIdentity, AxisPort, AxisStatistics, GroupQueue,
    axis::{Axis, Handles},
    parameters::Claims,
    shared::Shared,
};

/// A future that can be sent to another thread.
pub type BoxFuture<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// SDO access to the drive of an axis, for parameters and codes that are not in its process data.
pub trait ParameterAccess: Send + Sync {
    /// Writes an object; ready when the drive has confirmed it.
    fn write(&self, object: ObjectAddress, value: Vec<u8>) -> BoxFuture<'_, Result<(), SdoError>>;

    /// Reads an object.
    fn read(&self, object: ObjectAddress) -> BoxFuture<'_, Result<Vec<u8>, SdoError>>;
}

/// No SDO access: for axes with everything in their process data, in a program without a mailbox client.
///
/// ```
/// use servocrab::{axis::{NoParameters, ParameterAccess}, coe::ObjectAddress};
/// let read = NoParameters.read(ObjectAddress::new(0x603F, 0));
/// assert!(smol::block_on(read).is_err());
/// ```
#[derive(Debug, Clone, Copy, Default)]
pub struct NoParameters;

impl ParameterAccess for NoParameters {
    fn write(&self, object: ObjectAddress, _: Vec<u8>) -> BoxFuture<'_, Result<(), SdoError>> {
        let transfer = Transfer::write(object);
        Box::pin(async move { Err(SdoError::Closed { transfer }) })
    }

    fn read(&self, object: ObjectAddress) -> BoxFuture<'_, Result<Vec<u8>, SdoError>> {
        let transfer = Transfer::read(object);
        Box::pin(async move { Err(SdoError::Closed { transfer }) })
    }
}

/// What handles of an axis must know of it.
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::*;
/// use servocrab::coe::{AxisOffset, DriveId};
/// use servocrab::{drives, sii::Identity, units::AxisScale};
///
/// let layout = drives::generic().default_mapping()?.layout();
/// let fields = AxisFields::from_layout(&layout, AxisOffset::default())?;
/// let mut core = AxisCore::new(CoreConfig::new(fields));
/// let drive = DriveId { position: 0, name: "lift".into(), identity: Identity::default() };
/// let (source, mut port) = AxisSetup {
///     identity: AxisIdentity { axis: "z".into(), drive },
///     offset: AxisOffset::default(),
///     fields,
///     scale: AxisScale::COUNTS,
///     layout,
///     parameters: std::sync::Arc::new(NoParameters),
///     error_texts: std::sync::Arc::default(),
///     groups: GroupQueue::new(),
///     index: 0,
/// }
/// .open(&core);
///
/// // Handles go to the program, the port stays with the cycle.
/// let axis = source.axis();
/// let (now, mut outputs) = (Duration::from_millis(1), [0; 19]);
/// axis.stop_handle().stop();
/// port.before_send(&mut core, now, &mut outputs);
/// // … send the outputs, receive the inputs: Switch on disabled, 40h …
/// let inputs = [0x40, 0x02, 1, 0, 0, 0, 0, 0, 0, 0, 0];
/// core.step(now, Inputs::Fresh(&inputs), &mut outputs);
/// port.after_step(&mut core, Some(&inputs));
/// assert_eq!(axis.status().state, servocrab::ds402::State::SwitchOnDisabled);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct AxisSetup {
    /// The axis' name, and its drive.
    pub identity: AxisIdentity,
    /// By how much the axis' objects lie above those of the drive's first axis.
    pub offset: AxisOffset,
    /// Where the core's objects lie, as in its own configuration.
    pub fields: AxisFields,
    /// The unit of the axis, and its scale.
    pub scale: AxisScale,
    /// Where all mapped objects of the drive lie.
    pub layout: Layout,
    /// SDO access to the drive.
    pub parameters: Arc<dyn ParameterAccess>,
    /// What the drive's own error codes mean: for the texts of its faults.
    pub error_texts: Arc<ErrorTexts>,
    /// Where starts of several axes together are asked for: one queue for all axes of a network.
    pub groups: GroupQueue,
    /// The axis' number in its network, by which [`Groups`](super::Groups) asks for its core.
    pub index: usize,
}

impl fmt::Debug for AxisSetup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AxisSetup")
            .field("identity", &self.identity)
            .field("index", &self.index)
            .finish_non_exhaustive()
    }
}

impl AxisSetup {
    /// The two ends of an axis: where its handles come from, and the port for the loop that steps its core.
    #[must_use]
    pub fn open(self, core: &AxisCore) -> (AxisSource, AxisPort) {
        let shared = Arc::new(Shared::new(self, core));
        let source = AxisSource {
            shared: Arc::clone(&shared),
            handles: Arc::default(),
            claims: Arc::default(),
        };
        (source, AxisPort::new(shared))
    }
}

/// Where handles of an axis come from. It is no handle itself: it keeps no motion alive.
#[derive(Debug, Clone)]
pub struct AxisSource {
    shared: Arc<Shared>,
    handles: Arc<Mutex<Weak<Handles>>>,
    claims: Arc<Claims>,
}

impl AxisSource {
    /// The axis' name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.shared.identity.axis
    }

    /// What the handles know of the axis.
    pub(crate) fn setup(&self) -> &AxisSetup {
        &self.shared.setup
    }

    /// The latest snapshot, without a handle.
    pub(crate) fn snapshot(&self) -> Snapshot {
        self.shared.snapshot()
    }

    pub(crate) fn statistics(&self) -> AxisStatistics {
        let identity = AxisIdentity::clone(&self.shared.identity);
        self.shared.counts.read(identity)
    }

    /// Stops the axis in the next frame, without a handle.
    pub(crate) fn request_stop(&self, stop: StopRequest) {
        self.shared.request_stop(stop);
    }

    /// A handle; all that exist at a time belong together.
    #[must_use]
    pub fn axis(&self) -> Axis {
        let mut known = self.handles.lock().unwrap_or_else(PoisonError::into_inner);
        let handles = known.upgrade().unwrap_or_else(|| {
            let (shared, claims) = (Arc::clone(&self.shared), Arc::clone(&self.claims));
            let handles = Arc::new(Handles::new(shared, claims));
            *known = Arc::downgrade(&handles);
            handles
        });
        Axis::new(handles)
    }

    /// A handle that is none of the program's: that it is dropped stops nothing.
    pub(crate) fn uncounted_axis(&self) -> Axis {
        let (shared, claims) = (Arc::clone(&self.shared), Arc::clone(&self.claims));
        Axis::new(Arc::new(Handles::of_network(shared, claims)))
    }

    /// A handle in the unit in which the axis was declared.
    ///
    /// # Errors
    /// [`AxisErrorKind::WrongUnit`](super::AxisErrorKind::WrongUnit) where that is another.
    pub fn axis_in<U: AxisUnit>(&self) -> Result<Axis<U>, AxisError> {
        self.axis().declared_in()
    }
}

//! Moves in a program's own units that are not sent yet: several axes at once, and paths.

use core::{
    future::poll_fn,
    pin::Pin,
    task::{Context, Poll},
};

use smol::stream::{Map, Stream, StreamExt};

use super::{
    Scale, ScaledMove, ScaledOutcome, ScaledProfilePosition, scaled::in_scale,
    scaled_failure::in_units,
};
use crate::{
    axis::{self, AxisError, TogetherError},
    profile_position::{ByStream, Follow, MoveRequest, Path, PathError, Reference},
};

/// A move in a program's own units that is not sent yet.
#[must_use = "it is sent by `together` or `follow`"]
#[derive(Debug, Clone)]
pub struct ScaledMoveRequest {
    inner: MoveRequest,
    scale: Scale,
}

impl ScaledMoveRequest {
    pub(super) const fn new(inner: MoveRequest, scale: Scale) -> Self {
        Self { inner, scale }
    }
}

/// Starts moves of several axes of one network in one cycle, each in the units of its own axis, as
/// [`axis::together`](crate::axis::together) does.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::units::{self, Ratio, Scale, ScaledSetPoint};
/// let x = net.axis("x")?.scaled(Scale::counts_per_unit(Ratio::new(1000, 1)?)); // millimetres
/// let turret = net.axis("y")?.scaled(Scale::counts_per_unit(Ratio::new(3600, 360)?)); // degrees
/// x.enable().await?;
/// turret.enable().await?;
/// let (on_x, on_turret) = (x.profile_position().await?, turret.profile_position().await?);
/// let both = [
///     on_x.rel(2.5, ScaledSetPoint::new().velocity(50.0))?,
///     on_turret.rel(90.0, ScaledSetPoint::new().velocity(720.0))?,
/// ];
/// for motion in units::together(both).await? {
///     println!("{}", motion.done().await?);
/// }
/// assert!((turret.status().position - 90.0).abs() < 0.5);
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
///
/// # Errors
/// As [`axis::together`](crate::axis::together), with positions in the units of the axis that the error is of.
pub async fn together(
    requests: impl IntoIterator<Item = ScaledMoveRequest>,
) -> Result<Vec<ScaledMove>, TogetherError> {
    let requests: Vec<_> = requests.into_iter().collect();
    let scales: Vec<_> = requests
        .iter()
        .map(|request| (request.inner.axis.identity().clone(), request.scale))
        .collect();
    let inner = requests.into_iter().map(|request| request.inner);
    match axis::together(inner).await {
        Ok(moves) => {
            let moves = moves.into_iter().zip(scales);
            Ok(moves
                .map(|(inner, (_, scale))| ScaledMove::new(inner, scale))
                .collect())
        }
        Err(mut failed) => {
            let of = scales
                .iter()
                .find(|(axis, _)| *axis == *failed.error.identity);
            if let Some((_, scale)) = of {
                failed.error = in_units(failed.error, *scale);
            }
            Err(failed)
        }
    }
}

/// One move of a path, and how it ended, in a program's own units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledFollowed {
    /// What its target counts from.
    pub reference: Reference,
    /// Where to, or how far: units.
    pub target: f64,
    /// Its outcome.
    pub outcome: ScaledOutcome,
}

/// A move of a path did not end well, or could not be sent, in a program's own units.
#[derive(Debug, Clone, thiserror::Error)]
#[error("move {number} of the path (to {target}): {error}")]
pub struct ScaledPathError {
    /// Which one, from 0 on.
    pub number: usize,
    /// What its target counts from.
    pub reference: Reference,
    /// Where to, or how far: units.
    pub target: f64,
    /// Why.
    pub error: AxisError,
}

impl From<ScaledPathError> for AxisError {
    fn from(failed: ScaledPathError) -> Self {
        failed.error
    }
}

impl ScaledPathError {
    fn new(failed: PathError, scale: Scale) -> Self {
        Self {
            number: failed.number,
            reference: failed.command.reference,
            target: scale.position_of(failed.command.target),
            error: in_units(failed.error, scale),
        }
    }
}

/// A stream of moves in the drive's units.
type InCounts<S> = Map<S, fn(ScaledMoveRequest) -> MoveRequest>;

/// The outcomes of a path's moves, in their order, from [`ScaledProfilePosition::follow`]. It sends nothing unless it is polled.
#[must_use = "a path is sent while its outcomes are taken: `finish` takes them all"]
#[derive(Debug)]
pub struct ScaledFollow<'a, S> {
    inner: Follow<'a, InCounts<S>>,
    scale: Scale,
}

impl ScaledProfilePosition {
    /// Sends the moves of an iterator or a stream one after another, as
    /// [`ProfilePosition::follow`](crate::profile_position::ProfilePosition::follow).
    ///
    /// ```no_run
    /// # async fn path(on_x: &servocrab::units::ScaledProfilePosition) -> Result<(), servocrab::axis::AxisError> {
    /// use servocrab::{profile_position::Start, units::ScaledSetPoint};
    ///
    /// let blend = ScaledSetPoint::new().velocity(40.0).start(Start::Blend);
    /// let moves = [on_x.abs(1.0, blend)?, on_x.abs(4.0, blend)?, on_x.abs(9.5, blend)?];
    /// let mut path = on_x.follow(moves);
    /// while let Some(followed) = path.try_next().await? {
    ///     println!("{} mm: {}", followed.target, followed.outcome);
    /// }
    /// # Ok(())
    /// # }
    /// ```
    pub fn follow<K, P: Path<ScaledMoveRequest, K>>(
        &self,
        moves: P,
    ) -> ScaledFollow<'_, P::Stream> {
        let in_counts: fn(ScaledMoveRequest) -> MoveRequest = |request| request.inner;
        let moves: InCounts<P::Stream> = moves.into_stream().map(in_counts);
        ScaledFollow {
            inner: self.inner().follow::<ByStream, _>(moves),
            scale: self.scale(),
        }
    }
}

impl<S: Stream<Item = ScaledMoveRequest>> ScaledFollow<'_, S> {
    /// As [`Follow::next`].
    #[must_use = "this result reports a move that did not end well"]
    pub async fn next(&mut self) -> Option<Result<ScaledFollowed, ScaledPathError>> {
        poll_fn(|cx| Pin::new(&mut *self).poll_next(cx)).await
    }

    /// As [`Follow::try_next`].
    ///
    /// # Errors
    /// As [`Follow::try_next`], in the program's units.
    pub async fn try_next(&mut self) -> Result<Option<ScaledFollowed>, ScaledPathError> {
        self.next().await.transpose()
    }

    /// As [`Follow::finish`].
    ///
    /// # Errors
    /// As [`Follow::finish`], in the program's units.
    pub async fn finish(self) -> Result<Option<ScaledOutcome>, ScaledPathError> {
        let scale = self.scale;
        let end = self.inner.finish().await;
        end.map(|last| last.map(|last| in_scale(last, scale)))
            .map_err(|failed| ScaledPathError::new(failed, scale))
    }
}

impl<S: Stream<Item = ScaledMoveRequest>> Stream for ScaledFollow<'_, S> {
    type Item = Result<ScaledFollowed, ScaledPathError>;

    fn poll_next(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let this = self.get_mut();
        let scale = this.scale;
        Pin::new(&mut this.inner).poll_next(cx).map(|followed| {
            followed.map(|followed| {
                followed
                    .map(|followed| ScaledFollowed {
                        reference: followed.command.reference,
                        target: scale.position_of(followed.command.target),
                        outcome: in_scale(followed.outcome, scale),
                    })
                    .map_err(|failed| ScaledPathError::new(failed, scale))
            })
        })
    }
}

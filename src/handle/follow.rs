//! A path: moves from an iterator or a stream, sent as the drive has room for them.

use core::{
    fmt,
    future::poll_fn,
    pin::Pin,
    task::{Context, Poll},
};
use std::{collections::VecDeque, sync::Arc};

use smol::stream::{self, Stream};

use crate::{
    profile_position::MoveCommand,
    units::{AxisUnit, Counts},
};

use super::{
    AxisError, AxisErrorKind, BoxFuture, Move, MoveRequest, Outcome, ProfilePosition,
    stops::LastStop,
};

/// One move of a path, and how it ended.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Followed<U: AxisUnit = Counts> {
    /// What was asked for.
    pub command: MoveCommand<U>,
    /// Its outcome.
    pub outcome: Outcome<U>,
}

impl Eq for Followed {}

/// A move of a path did not end well, or could not be sent.
#[derive(Debug, Clone, thiserror::Error)]
#[error("move {number} of the path (to {}): {error}", .command.target)]
#[non_exhaustive]
pub struct PathError<U: AxisUnit = Counts> {
    /// Which one, from 0 on.
    pub number: usize,
    /// What was asked for.
    pub command: MoveCommand<U>,
    /// Why.
    pub error: AxisError,
}

impl<U: AxisUnit> From<PathError<U>> for AxisError {
    fn from(failed: PathError<U>) -> Self {
        failed.error
    }
}

/// What gives the moves of a path, `M`: every [`IntoIterator`] and every [`Stream`]. `Kind` says which of them it is, and is
/// inferred.
pub trait Path<M, Kind> {
    /// The moves as a stream.
    type Stream: Stream<Item = M>;

    /// Makes it that.
    fn into_stream(self) -> Self::Stream;
}

/// A [`Path`] that is an iterator.
#[derive(Debug)]
pub enum ByIterator {}

/// A [`Path`] that is a stream.
#[derive(Debug)]
pub enum ByStream {}

impl<I: IntoIterator> Path<I::Item, ByIterator> for I {
    type Stream = stream::Iter<I::IntoIter>;

    fn into_stream(self) -> Self::Stream {
        stream::iter(self)
    }
}

impl<S: Stream> Path<S::Item, ByStream> for S {
    type Stream = S;

    fn into_stream(self) -> Self::Stream {
        self
    }
}

/// A move under way, by its number and what was asked for.
type UnderWay<U, T> = (
    usize,
    MoveCommand<U>,
    BoxFuture<'static, Result<T, AxisError>>,
);

/// The outcomes of a path's moves, in their order, from [`ProfilePosition::follow`]. It sends nothing unless it is polled.
#[must_use = "a path is sent while its outcomes are taken: `finish` takes them all"]
pub struct Follow<'a, S, U: AxisUnit = Counts> {
    lease: &'a ProfilePosition<U>,
    /// `None` once it has ended, or a move has failed.
    moves: Option<Pin<Box<S>>>,
    count: usize,
    /// The last stop when its first move was taken.
    asked: Option<LastStop>,
    sending: Option<UnderWay<U, Move<U>>>,
    under_way: VecDeque<UnderWay<U, Outcome<U>>>,
    /// The first that was reported, for [`finish`](Self::finish).
    failed: Option<PathError<U>>,
    last: Option<Outcome<U>>,
}

impl<U: AxisUnit> ProfilePosition<U> {
    /// Sends the moves of an iterator or a stream one after another and keeps the drive's buffer filled. The next one is taken as
    /// soon as the one before is acknowledged, and is sent when the drive has room. Gives every outcome, in the order of the moves.
    /// [`Follow::finish`] gives the one result of them all.
    ///
    /// After the first move that does not end well nothing more is taken; what was sent or waits by then is executed and
    /// reported to its end, unless a stop comes. A halt so ends the path behind the moves that the drive holds, which go on when the axis is
    /// resumed. Every stop ends it, also one between two of its moves, and enabling the axis does not take that back. Dropped, the move
    /// that waits is withdrawn, and those that the drive holds are executed. A move of another axis is such a failure as well
    /// ([`AxisErrorKind::OtherAxis`]), and is not sent.
    ///
    /// Give the moves [`BufferMode::Buffered`](crate::BufferMode::Buffered) or [`BufferMode::Blending`](crate::BufferMode::Blending): one with
    /// [`BufferMode::Aborting`](crate::BufferMode::Aborting) supersedes those before it, which is a failure of theirs.
    ///
    /// ```no_run
    /// # async fn path(pp: &servocrab::ProfilePosition) -> Result<(), servocrab::AxisError> {
    /// use servocrab::{BufferMode, SetPoint};
    ///
    /// let blend = SetPoint::new().velocity(20_000).buffer_mode(BufferMode::Blending);
    /// let there = [1_000, 4_000, 9_000].map(|target| pp.abs(target, blend));
    /// pp.follow(there).finish().await?;
    ///
    /// let back = [4_000, 1_000, 0].map(|target| pp.abs(target, blend));
    /// let mut path = pp.follow(back);
    /// while let Some(followed) = path.try_next().await? {
    ///     println!("{}: {}", followed.command.target, followed.outcome);
    /// }
    /// # Ok(())
    /// # }
    /// ```
    pub fn follow<K, P: Path<MoveRequest<U>, K>>(&self, moves: P) -> Follow<'_, P::Stream, U> {
        Follow {
            lease: self,
            moves: Some(Box::pin(moves.into_stream())),
            count: 0,
            asked: None,
            sending: None,
            under_way: VecDeque::new(),
            failed: None,
            last: None,
        }
    }
}

impl<U: AxisUnit, S: Stream<Item = MoveRequest<U>>> Follow<'_, S, U> {
    /// The next outcome; none after the last one.
    #[must_use = "this result reports a move that did not end well"]
    pub async fn next(&mut self) -> Option<Result<Followed<U>, PathError<U>>> {
        poll_fn(|cx| Pin::new(&mut *self).poll_next(cx)).await
    }

    /// The next outcome, and a failure as an error; none after the last one.
    ///
    /// # Errors
    /// [`PathError`] of a move that did not end well.
    pub async fn try_next(&mut self) -> Result<Option<Followed<U>>, PathError<U>> {
        self.next().await.transpose()
    }

    /// Sends what is left and waits for the end of all moves. Gives the outcome of the last one; none where the path is empty.
    ///
    /// # Errors
    /// The first [`PathError`], also where [`next`](Self::next) reported it before.
    pub async fn finish(mut self) -> Result<Option<Outcome<U>>, PathError<U>> {
        while let Some(followed) = self.next().await {
            // It is kept.
            drop(followed);
        }
        match self.failed {
            Some(failed) => Err(failed),
            None => Ok(self.last),
        }
    }

    /// Takes the next move, where none is being sent. Whether there is one to send now.
    fn take_next(&mut self, cx: &mut Context<'_>) -> bool {
        if self.sending.is_none()
            && let Some(moves) = &mut self.moves
        {
            match moves.as_mut().poll_next(cx) {
                Poll::Ready(Some(request)) => {
                    let (number, command) = (self.count, request.command);
                    self.count += 1;
                    let shared = &self.lease.axis.handles.shared;
                    // A path outlives no stop, also where the axis was enabled or resumed before it is looked at again.
                    let asked = *self.asked.get_or_insert_with(|| shared.stops.last());
                    let sending: BoxFuture<'static, Result<Move<U>, AxisError>> =
                        if Arc::ptr_eq(shared, &request.axis.handles.shared) {
                            Box::pin(request.send_asked(asked))
                        } else {
                            let axis = request.axis.identity().axis.clone();
                            let error = shared.error(AxisErrorKind::OtherAxis { axis });
                            Box::pin(core::future::ready(Err(error)))
                        };
                    self.sending = Some((number, command, sending));
                }
                Poll::Ready(None) => self.moves = None,
                Poll::Pending => {}
            }
        }
        self.sending.is_some()
    }

    /// Sends the next move, as far as that goes; whether one was sent, or refused.
    fn send_next(&mut self, cx: &mut Context<'_>) -> bool
    where
        S: Stream<Item = MoveRequest<U>>,
    {
        if !self.take_next(cx) {
            return false;
        }
        let Some((number, command, sending)) = &mut self.sending else {
            return false;
        };
        let Poll::Ready(sent) = sending.as_mut().poll(cx) else {
            return false;
        };
        let (number, command) = (*number, *command);
        self.sending = None;
        if sent.is_err() {
            self.moves = None;
        }
        let end = async move { sent?.done_through_halt().await };
        self.under_way.push_back((number, command, Box::pin(end)));
        true
    }

    /// What a move that has ended gives.
    fn ended(
        &mut self,
        number: usize,
        command: MoveCommand<U>,
        result: Result<Outcome<U>, AxisError>,
    ) -> Result<Followed<U>, PathError<U>> {
        match result {
            Ok(outcome) => {
                self.last = Some(outcome);
                Ok(Followed { command, outcome })
            }
            Err(error) => {
                self.moves = None;
                let failed = PathError {
                    number,
                    command,
                    error,
                };
                self.failed.get_or_insert_with(|| failed.clone());
                Err(failed)
            }
        }
    }
}

impl<U: AxisUnit, S: Stream<Item = MoveRequest<U>>> Stream for Follow<'_, S, U> {
    type Item = Result<Followed<U>, PathError<U>>;

    fn poll_next(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let this = self.get_mut();
        // How a move has ended is looked at before another is sent: none follows one that failed while nobody polled.
        loop {
            if let Some((number, command, end)) = this.under_way.front_mut()
                && let Poll::Ready(result) = end.as_mut().poll(cx)
            {
                let (number, command) = (*number, *command);
                this.under_way.pop_front();
                return Poll::Ready(Some(this.ended(number, command, result)));
            }
            if !this.send_next(cx) {
                break;
            }
        }
        let has_moves = this.moves.is_some() || this.sending.is_some();
        if has_moves || !this.under_way.is_empty() {
            Poll::Pending
        } else {
            Poll::Ready(None)
        }
    }
}

impl<U: AxisUnit, S> fmt::Debug for Follow<'_, S, U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sending = self.sending.as_ref().map(|(_, command, _)| command);
        f.debug_struct("Follow")
            .field("sending", &sending)
            .field("under_way", &self.under_way.len())
            .finish_non_exhaustive()
    }
}

/// What a program leaves unused of a path warns.
///
/// ```
/// #![deny(unused_must_use)]
/// # use servocrab::{ProfilePosition, SetPoint, profile_position::PathError};
/// async fn path(pp: &ProfilePosition) -> Result<(), PathError> {
///     let mut path = pp.follow([pp.abs(1, SetPoint::new())]);
///     let _ = path.next().await;
///     path.finish().await?;
///     Ok(())
/// }
/// ```
///
/// ```compile_fail
/// #![deny(unused_must_use)]
/// # use servocrab::{ProfilePosition, SetPoint, profile_position::PathError};
/// async fn path(pp: &ProfilePosition) -> Result<(), PathError> {
///     pp.follow([pp.abs(1, SetPoint::new())]);
///     Ok(())
/// }
/// ```
///
/// ```compile_fail
/// #![deny(unused_must_use)]
/// # use servocrab::{ProfilePosition, SetPoint, profile_position::PathError};
/// async fn path(pp: &ProfilePosition) -> Result<(), PathError> {
///     let mut path = pp.follow([pp.abs(1, SetPoint::new())]);
///     path.next().await;
///     path.finish().await?;
///     Ok(())
/// }
/// ```
///
/// ```compile_fail
/// #![deny(unused_must_use)]
/// # use servocrab::{ProfilePosition, SetPoint, profile_position::PathError};
/// async fn path(pp: &ProfilePosition) -> Result<(), PathError> {
///     pp.follow([pp.abs(1, SetPoint::new())]).finish().await;
///     Ok(())
/// }
/// ```
#[cfg(doctest)]
struct Unused;

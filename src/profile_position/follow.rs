//! A path: moves from a stream, sent as the drive has room for them.

use core::{
    fmt,
    marker::PhantomData,
    pin::Pin,
    task::{Context, Poll},
};
use std::collections::VecDeque;

use smol::stream::Stream;

use crate::axis::{AxisError, BoxFuture};

use super::{Move, MoveCommand, MoveRequest, Outcome, ProfilePosition};

/// One move of a path, and how it ended.
#[derive(Debug)]
pub struct Followed {
    /// What was asked for.
    pub command: MoveCommand,
    /// Its outcome.
    pub result: Result<Outcome, AxisError>,
}

/// The outcomes of a path's moves, in their order, from [`ProfilePosition::follow`]. It sends nothing unless it is polled.
#[must_use = "a path is sent while its outcomes are taken"]
pub struct Follow<'a, S> {
    /// `None` once it has ended, or a move has failed.
    moves: Option<S>,
    sending: Option<(MoveCommand, BoxFuture<'static, Result<Move, AxisError>>)>,
    under_way: VecDeque<(MoveCommand, BoxFuture<'static, Result<Outcome, AxisError>>)>,
    lease: PhantomData<&'a ProfilePosition>,
}

impl ProfilePosition {
    /// Sends the moves of a stream one after another and keeps the drive's buffer filled: the next one is taken from the
    /// stream as soon as the one before is acknowledged, and is sent when the drive has room. Gives every outcome, in the
    /// order of the moves.
    ///
    /// After the first move that does not end well nothing more is taken from the stream; what was sent or waits by then is
    /// reported to its end. A halt so ends the path behind the moves that the drive holds, which go on when the axis is
    /// resumed. Dropped, the move that waits is withdrawn, and those that the drive holds are executed.
    ///
    /// Give the moves [`Start::AfterCurrent`](super::Start::AfterCurrent) or [`Start::Blend`](super::Start::Blend): one with
    /// [`Start::Immediately`](super::Start::Immediately) supersedes those before it, which is a failure of theirs.
    ///
    /// ```no_run
    /// # async fn path(pp: &servocrab::profile_position::ProfilePosition) -> Result<(), servocrab::axis::AxisError> {
    /// use servocrab::profile_position::{SetPoint, Start};
    /// use smol::stream::{self, StreamExt};
    ///
    /// let blend = SetPoint::new().velocity(20_000).start(Start::Blend);
    /// let mut path = pp.follow(stream::iter([1_000, 4_000, 9_000].map(|target| pp.abs(target, blend))));
    /// while let Some(followed) = path.next().await {
    ///     println!("{} ended: {:?}", followed.command.target, followed.result?);
    /// }
    /// # Ok(())
    /// # }
    /// ```
    pub fn follow<S>(&self, moves: S) -> Follow<'_, S>
    where
        S: Stream<Item = MoveRequest> + Unpin,
    {
        Follow {
            moves: Some(moves),
            sending: None,
            under_way: VecDeque::new(),
            lease: PhantomData,
        }
    }
}

impl<S: Stream<Item = MoveRequest> + Unpin> Follow<'_, S> {
    /// Takes the next move from the stream, where none is being sent. Whether there is one to send now.
    fn take_next(&mut self, cx: &mut Context<'_>) -> bool {
        if self.sending.is_none()
            && let Some(moves) = &mut self.moves
        {
            match Pin::new(moves).poll_next(cx) {
                Poll::Ready(Some(request)) => {
                    self.sending = Some((request.command, Box::pin(request.send())));
                }
                Poll::Ready(None) => self.moves = None,
                Poll::Pending => {}
            }
        }
        self.sending.is_some()
    }
}

impl<S: Stream<Item = MoveRequest> + Unpin> Stream for Follow<'_, S> {
    type Item = Followed;

    fn poll_next(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Followed>> {
        let this = self.get_mut();
        while this.take_next(cx) {
            let Some((command, sending)) = &mut this.sending else {
                break;
            };
            let Poll::Ready(sent) = sending.as_mut().poll(cx) else {
                break;
            };
            let command = *command;
            this.sending = None;
            if sent.is_err() {
                this.moves = None;
            }
            let end = async move { sent?.done_through_halt().await };
            this.under_way.push_back((command, Box::pin(end)));
        }
        let Some((command, end)) = this.under_way.front_mut() else {
            let over = this.moves.is_none() && this.sending.is_none();
            return if over {
                Poll::Ready(None)
            } else {
                Poll::Pending
            };
        };
        let Poll::Ready(result) = end.as_mut().poll(cx) else {
            return Poll::Pending;
        };
        let command = *command;
        this.under_way.pop_front();
        if result.is_err() {
            this.moves = None;
        }
        Poll::Ready(Some(Followed { command, result }))
    }
}

impl<S> fmt::Debug for Follow<'_, S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Follow")
            .field(
                "sending",
                &self.sending.as_ref().map(|(command, _)| command),
            )
            .field("under_way", &self.under_way.len())
            .finish_non_exhaustive()
    }
}

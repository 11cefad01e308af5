//! What an axis shares.

pub(crate) use servocrab::{
    Failure, StopRequest,
    axis::{Command, CommandId, Completion, Delivery, Snapshot},
};

#[path = "../../../src/handle/output_cells.rs"]
mod output_cells;
#[path = "../../../src/handle/request.rs"]
mod request;
#[path = "../../../src/handle/status.rs"]
mod status;
#[path = "../../../src/handle/stops.rs"]
mod stops;

use servocrab::{coe::obj, drives, pdo_map::Direction};

use output_cells::OutputCells;
use request::AxisRequest;
use status::{StatusCell, pack};
use stops::{LastStop, StopKind, Stops};

/// The status of an axis with eight input bytes.
pub(crate) struct Status(StatusCell);

impl Status {
    pub(crate) fn new(first: &Snapshot) -> Self {
        Self(StatusCell::new(first, 8))
    }

    pub(crate) fn publish(&self, snapshot: &Snapshot, inputs: [u8; 8]) {
        self.0.publish(pack(snapshot), Some(&inputs));
    }

    pub(crate) fn read(&self) -> Snapshot {
        self.0.sample(|snapshot, _| snapshot)
    }

    pub(crate) fn inputs(&self) -> [u8; 8] {
        self.0.sample(|_, inputs| inputs.bytes(0))
    }
}

/// The outputs of a drive that the program sets.
pub(crate) struct Outputs {
    cells: OutputCells,
    place: usize,
    byte: usize,
    length: usize,
}

impl Outputs {
    pub(crate) fn new() -> Self {
        let layout = drives::generic().default_mapping().unwrap().layout();
        let object = obj::PROFILE_VELOCITY.address();
        let cells = OutputCells::of(&layout, None);
        Self {
            place: cells.place_of(object).unwrap(),
            byte: layout
                .find(Direction::Outputs, object.index, object.subindex)
                .unwrap()
                .byte,
            length: layout.output_bytes(),
            cells,
        }
    }

    pub(crate) fn set(&self, value: u32) {
        assert!(self.cells.set(self.place, value));
    }

    /// What lies in the frame after this.
    pub(crate) fn merge_into(&self, frame: &mut Vec<u8>) -> u32 {
        frame.resize(self.length, 0);
        self.cells.merge(frame);
        let bytes = frame[self.byte..self.byte + 4].try_into().unwrap();
        u32::from_le_bytes(bytes)
    }
}

/// A halt that was asked for once, or a question to the axis core.
pub(crate) struct OneRequest {
    request: AxisRequest,
    stops: Stops,
}

impl OneRequest {
    pub(crate) fn halt() -> Self {
        Self::of(Command::Halt)
    }

    pub(crate) fn question() -> Self {
        Self::of(Command::CheckHome)
    }

    fn of(command: Command) -> Self {
        let stops = Stops::new();
        let asked = stops.note(StopKind::Halt);
        Self {
            request: AxisRequest::new(CommandId(1), command, 0, asked),
            stops,
        }
    }

    /// Another handle halts the axis: whether it shares the halt, and which it is.
    pub(crate) fn join(&self) -> (bool, u64) {
        let stop = self.stops.note(StopKind::Halt);
        (self.request.join(stop), stop.0)
    }

    pub(crate) fn leave(&self) {
        self.request.leave();
    }

    /// Gives it up, and says whether the drive will not take it any more.
    pub(crate) fn give_up(&self) -> bool {
        self.request.give_up(false);
        self.request.is_over()
    }

    pub(crate) fn take(&self) -> bool {
        self.request.take()
    }

    pub(crate) fn is_withdrawn(&self) -> bool {
        self.request.take_withdrawal().is_some()
    }

    /// Carries it out until it is over, on the bus thread, the first time with this result. Gives the last halt that was carried out.
    pub(crate) fn carry_out(&self, first: Result<Completion, Failure>) -> u64 {
        let mut result = first;
        loop {
            let LastStop(asked) = self.request.asked();
            if self.request.end(LastStop(asked), result) {
                return asked;
            }
            result = Ok(Completion::Done);
        }
    }

    pub(crate) fn is_waited_for(&self) -> bool {
        self.request.is_waited_for()
    }

    pub(crate) fn result(&self) -> Option<Result<Completion, Failure>> {
        self.request.result()
    }
}

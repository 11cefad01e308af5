//! Selecting a mode from a handle: 6060h and 6061h in the process data, or by SDO where they are not there.

use crate::{coe::ObjectAddress, ds402::Mode};

use super::{Axis, AxisError, Command};

const MODE_OF_OPERATION: ObjectAddress = ObjectAddress::new(0x6060, 0);
const MODE_OF_OPERATION_DISPLAY: ObjectAddress = ObjectAddress::new(0x6061, 0);

impl Axis {
    /// Selects a mode; ready when the drive shows it.
    pub(crate) async fn select(&self, mode: Mode) -> Result<(), AxisError> {
        let handles = &self.handles;
        let fields = &handles.shared.setup.fields;
        if fields.mode.is_none() {
            // Nothing is written before the axis has said that it stands and that nothing of the last mode is left.
            let preparing = self.submit(Command::PrepareMode(mode))?;
            preparing.withdraw_on_drop().done().await?;
            if fields.mode_display.is_none() {
                // What was read before says nothing from here on.
                handles.shared.note_mode(Mode::None.raw());
            }
            handles
                .write_parameter(MODE_OF_OPERATION, vec![mode.raw().cast_unsigned()])
                .await?;
        }
        let pending = self.submit(Command::SelectMode(mode))?.withdraw_on_drop();
        if fields.mode_display.is_some() {
            return pending.done().await.map(drop);
        }
        let shown = async {
            loop {
                let value = handles.read_parameter(MODE_OF_OPERATION_DISPLAY).await?;
                if let Some(raw) = value.first() {
                    handles.shared.note_mode(raw.cast_signed());
                }
                // The mailbox sets the pace: a transfer takes some cycles.
                smol::future::yield_now().await;
            }
        };
        smol::future::or(async { pending.done().await.map(drop) }, shown).await
    }
}

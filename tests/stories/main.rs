//! The whole system, told as tests. Each story is named by its moral; the demo's binary plays the programs in it.
//!
//! `TACTUS_RIG=rig.toml cargo test -p tactus-tests` plays the same stories on the instruments that `rig.toml` names (a
//! configuration of `tactusd`; its record and bus are replaced by the story's own). Each story declares what it needs
//! and its largest current; what a rig does not have is skipped, and the reason printed.

mod scenery;

mod a_baseline_repeats;
mod a_conversation_is_played_again;
mod a_frame_travels_as_text;
mod a_lost_source_opens_the_relays_and_is_verified_off_on_return;
mod a_network_keeps_watch;
mod a_night_of_logging;
mod a_pattern_is_a_setting;
mod a_recording_is_a_rig;
mod an_overload_is_a_gap_not_a_number;
mod anyone_can_listen;
mod bad_input_is_named;
mod baseline_then_press;
mod cli_speaks_json;

mod instruments_are_found_and_never_used;
mod kill_nine_loses_nothing_acknowledged;
mod manual;
mod rules;
mod test_one_is_found;
mod text_from_outside_acts_on_nothing;
mod the_contract_is_what_we_say;
mod the_paper_is_run_over_scpi;
mod the_rig_tests_itself;
mod two_wirings_one_frame;

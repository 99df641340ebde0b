//! The sampled, delayed, linearised loop as a whole: where the rule of its fastest mode \[11] says nothing, or not enough.

pub mod radius;

mod circle;
#[cfg(test)]
mod dense;
mod modal;
#[cfg(test)]
mod tests;

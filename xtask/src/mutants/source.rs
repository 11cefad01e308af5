//! What a source file consists of: its functions and other items by their paths, and where each begins and ends.

use std::ops::Range;

use proc_macro2::Span;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};

/// A function, or another item that a mutant can change.
#[derive(Debug)]
pub(crate) struct Item {
    /// The path inside the file: `Track::is_left_behind`, `<Track as Display>::fmt`, `tests::bench`.
    pub(crate) path: String,
    /// From its first attribute to its last character.
    pub(crate) range: Range<usize>,
    /// The blocks of a function's body, each with its braces: the body and all that it contains. Empty for other items.
    pub(crate) blocks: Vec<Range<usize>>,
    /// The word `const` of a constant function.
    pub(crate) constant: Option<Range<usize>>,
}

/// All items of a file.
pub(crate) fn items(text: &str) -> syn::Result<Vec<Item>> {
    let mut reader = Reader::default();
    reader.visit_file(&syn::parse_file(text)?);
    Ok(reader.items)
}

#[derive(Default)]
struct Reader {
    /// The names around the item that is visited.
    around: Vec<String>,
    items: Vec<Item>,
    /// The function whose blocks are visited.
    function: Option<usize>,
}

impl Reader {
    fn within(&mut self, name: String, visit: impl FnOnce(&mut Self)) {
        self.around.push(name);
        visit(self);
        self.around.pop();
    }

    fn add(&mut self, name: &str, span: Span, constant: Option<Span>) -> usize {
        let mut path = self.around.join("::");
        if !path.is_empty() {
            path.push_str("::");
        }
        path.push_str(name);
        self.items.push(Item {
            path,
            range: span.byte_range(),
            blocks: Vec::new(),
            constant: constant.map(|span| span.byte_range()),
        });
        self.items.len() - 1
    }

    fn function(&mut self, span: Span, signature: &syn::Signature, body: &syn::Block) {
        let name = signature.ident.to_string();
        let constant = signature.constness.map(|word| word.span());
        let outer = self.function;
        self.function = Some(self.add(&name, span, constant));
        self.within(name, |reader| reader.visit_block(body));
        self.function = outer;
    }

    /// An item without blocks that could run.
    fn other(&mut self, name: &str, span: Span, visit: impl FnOnce(&mut Self)) {
        self.add(name, span, None);
        let outer = self.function.take();
        self.within(name.to_owned(), visit);
        self.function = outer;
    }
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        self.within(item.ident.to_string(), |reader| {
            visit::visit_item_mod(reader, item);
        });
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let of = type_name(&item.self_ty);
        let name = match &item.trait_ {
            Some((_, of_trait, _)) => format!("<{of} as {}>", last(of_trait)),
            None => of,
        };
        self.within(name, |reader| visit::visit_item_impl(reader, item));
    }

    fn visit_item_trait(&mut self, item: &'ast syn::ItemTrait) {
        self.within(item.ident.to_string(), |reader| {
            visit::visit_item_trait(reader, item);
        });
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        self.function(item.span(), &item.sig, &item.block);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        self.function(item.span(), &item.sig, &item.block);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        if let Some(body) = &item.default {
            self.function(item.span(), &item.sig, body);
        }
    }

    fn visit_block(&mut self, block: &'ast syn::Block) {
        if let Some(function) = self.function {
            self.items[function].blocks.push(block.span().byte_range());
        }
        visit::visit_block(self, block);
    }

    fn visit_item_const(&mut self, item: &'ast syn::ItemConst) {
        self.other(&item.ident.to_string(), item.span(), |reader| {
            visit::visit_item_const(reader, item);
        });
    }

    fn visit_impl_item_const(&mut self, item: &'ast syn::ImplItemConst) {
        self.other(&item.ident.to_string(), item.span(), |reader| {
            visit::visit_impl_item_const(reader, item);
        });
    }

    fn visit_item_static(&mut self, item: &'ast syn::ItemStatic) {
        self.other(&item.ident.to_string(), item.span(), |reader| {
            visit::visit_item_static(reader, item);
        });
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        self.other(&item.ident.to_string(), item.span(), |reader| {
            visit::visit_item_struct(reader, item);
        });
    }

    fn visit_item_enum(&mut self, item: &'ast syn::ItemEnum) {
        self.other(&item.ident.to_string(), item.span(), |reader| {
            visit::visit_item_enum(reader, item);
        });
    }

    fn visit_item_macro(&mut self, item: &'ast syn::ItemMacro) {
        let name = item
            .ident
            .as_ref()
            .map_or_else(|| last(&item.mac.path), ToString::to_string);
        self.add(&format!("{name}!"), item.span(), None);
    }

    fn visit_expr_const(&mut self, _: &'ast syn::ExprConst) {
        // Its blocks run in the compiler.
    }
}

fn last(path: &syn::Path) -> String {
    path.segments
        .last()
        .map_or_else(String::new, |segment| segment.ident.to_string())
}

/// The name of a type without its parameters.
fn type_name(of: &syn::Type) -> String {
    match of {
        syn::Type::Path(path) => last(&path.path),
        syn::Type::Reference(reference) => format!("&{}", type_name(&reference.elem)),
        syn::Type::Slice(slice) => format!("[{}]", type_name(&slice.elem)),
        syn::Type::Array(array) => format!("[{}]", type_name(&array.elem)),
        _ => "_".to_owned(),
    }
}

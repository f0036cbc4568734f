// Applies the JSON Patches (RFC 6902) of arpd/report/json_patch.py.

/** Change a document in place; a patch of the whole document is never sent, because its keys stay. */
export function apply(document, operations) {
  for (const { op, path, value } of operations) {
    const keys = path.split("/").slice(1);
    const last = unescaped(keys.pop());
    const place = keys.reduce((inner, key) => inner[unescaped(key)], document);
    if (op === "remove") place.splice(Number(last), 1);
    else if (op === "add") place.push(value);
    else place[last] = value;
  }
}

const unescaped = (key) => key.replaceAll("~1", "/").replaceAll("~0", "~");

"""Re-wraps paragraphs and list items that have a line of more than 138 characters, or (with --ragged) a very short inner line."""
import pathlib,re,sys,textwrap
W=136
for name in sys.argv[1:]:
    p=pathlib.Path(name); lines=p.read_text().split('\n'); out=[]; i=0; fence=False; n=0
    while i<len(lines):
        l=lines[i]
        if l.startswith('```') or l.startswith('~~~'): fence=not fence
        if fence or l.startswith('```') or not l.strip() or re.match(r'\s*\||#|    |<|!\[|\$',l) or re.match(r' {4}',l):
            out.append(l); i+=1; continue
        m=re.match(r'(\s*)([-*] |\d+\. )?',l)
        indent=m.group(1); first=m.group(0); rest=' '*len(first)
        j=i+1
        while j<len(lines) and lines[j].strip() and not re.match(r'\s*([-*] |\d+\. |\||#|```|<)',lines[j]) and len(lines[j])-len(lines[j].lstrip())==len(rest): j+=1
        para=lines[i:j]
        ragged=any(len(x)<90 for x in para[:-1])
        if any(len(x)>138 for x in para) or ragged and '--r' in name:
            text=' '.join(x.strip() for x in para)
            # keep after bullet
            text=text[len(first.strip())+1:] if m.group(2) else text
            new=textwrap.wrap(text,width=W,initial_indent=first,subsequent_indent=rest,break_long_words=False,break_on_hyphens=False)
            n+=1; out+=new
        else: out+=para
        i=j
    p.write_text('\n'.join(out))
    print(name,n)
